"""Benchmark of the running graph: latency, CPU, memory."""
