"""Films: markers tracked through them, camera calibration, printed markers."""
