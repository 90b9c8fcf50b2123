"""Fit of leg parameters to measurements: data, experiments, fit, parameter file."""
