"""Report of results as one HTML file: benchmarks, runs and the paper's figures beside ours."""
