"""Massless legs: the table of their statics, and the robot that stands on them."""
