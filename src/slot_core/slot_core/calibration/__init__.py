"""Free parameters of a leg fitted to measurements: data, experiments, fit, parameter file."""
