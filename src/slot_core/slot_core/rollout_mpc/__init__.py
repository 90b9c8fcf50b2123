"""Rollout MPC: policy that simulates the robot over the next stride."""
