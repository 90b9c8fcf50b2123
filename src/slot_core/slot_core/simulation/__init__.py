"""What stands in for the hardware: simulated robots, their sensors and their servos."""
