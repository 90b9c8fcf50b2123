"""Convex model predictive controller: problem and solver."""
