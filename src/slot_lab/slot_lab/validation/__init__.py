"""Validation of a run against a measurement: alignment in time and space, errors, tables, plots."""
