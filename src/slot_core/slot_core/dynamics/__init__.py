"""Equations of motion of the robot (rod, tendon, contact, torso, servo) and their integration."""
