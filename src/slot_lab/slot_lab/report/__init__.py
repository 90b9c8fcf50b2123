"""Reports on walks: metrics, summary, plots and the Dynamic Constraint Map."""
