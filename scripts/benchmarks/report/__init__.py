"""Report of results as one page in Markdown: benchmarks, runs and the paper's figures beside ours."""
