"""Driver of the Dynamixel XL430-W250 servos."""
