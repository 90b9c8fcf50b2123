"""Drawing of the robot: shapes for any 3-D viewer, kept up to date by messages."""
