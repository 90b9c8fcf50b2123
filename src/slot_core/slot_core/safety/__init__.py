"""What may stop the robot: supervisor, conditions, watchdog and rate limiter of the servos."""
