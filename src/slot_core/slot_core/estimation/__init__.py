"""State estimation: from odometry and IMU to the state of the torso."""
