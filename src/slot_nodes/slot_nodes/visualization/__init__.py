"""The robot as markers for RViz and Foxglove."""
