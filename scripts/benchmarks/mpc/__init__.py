"""Benchmark of the MPC: accuracy and speed of its solvers."""
