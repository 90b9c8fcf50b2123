"""Reports on runs: metrics, summary, plots and the dynamic constraint map."""
