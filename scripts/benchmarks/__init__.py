"""Benchmarks of scripts/bench, one folder each."""
