"""Gaits: strides, schedule, routes and reference."""
