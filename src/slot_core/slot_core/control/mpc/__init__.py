"""The convex model predictive controller: problem, solvers, disturbance observer."""
