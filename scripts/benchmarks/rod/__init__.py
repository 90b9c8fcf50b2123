"""Benchmark of the Cosserat rod: exact values and peers."""
