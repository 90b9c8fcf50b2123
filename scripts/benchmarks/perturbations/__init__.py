"""Benchmark of the closed loop's response to perturbations, and the paper's table."""
