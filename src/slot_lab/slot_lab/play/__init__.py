"""The simulated robot to play with: commands, changes and pushes while it runs."""
