"""What may stop the robot: supervisor, conditions, command gate, watchdogs."""
