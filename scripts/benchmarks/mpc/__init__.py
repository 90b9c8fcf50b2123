"""Benchmark of the MPC: solvers, accuracy, speed."""
