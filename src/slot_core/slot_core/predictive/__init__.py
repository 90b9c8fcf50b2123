"""Predictive policy: MPC that simulates the robot over the next stride."""
