"""Page of a run: the robot in motion and its curves, in one HTML file that needs nothing else."""
