"""Benchmarks of scripts/bench: harness, command line, and one folder each."""
