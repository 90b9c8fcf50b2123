"""Films: markers tracked through them, camera calibration, synthetic films, printed markers."""
