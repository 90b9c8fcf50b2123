"""State error at the time of use, with delayed, lost and jumping odometry."""
