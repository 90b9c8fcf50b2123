"""Convex model predictive controller: problem, solvers, disturbance observer."""
