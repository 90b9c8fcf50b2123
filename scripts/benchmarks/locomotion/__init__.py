"""Benchmark of the locomotion: what the controller adds to the gait, row by row."""
