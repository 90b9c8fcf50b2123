"""Benchmark of the simulated robot: error, cost, hard cases."""
