"""What is learned from runs: bags, metrics, replay, plots and benchmark reports."""
