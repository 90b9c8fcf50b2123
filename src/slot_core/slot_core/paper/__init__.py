"""The published model of leg and robot, as printed in the paper, for comparison."""
