"""Controller: the chain from odometry to tendon angles in one process."""
