"""What the robot is: rod, tendon, contact, torso, servo, sensors and their integration in time."""
