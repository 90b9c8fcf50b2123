"""Supervisor, its conditions, watchdog and rate limiter of the servos: they may stop the robot."""
