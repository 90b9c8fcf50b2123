"""Benchmark of the servo bus: rate, age of commands."""
