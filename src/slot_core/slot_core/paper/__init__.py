"""The model of leg and robot as the paper prints it, for comparison."""
