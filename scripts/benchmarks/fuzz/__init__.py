"""Benchmark of hostile input: what is refused, and how."""
