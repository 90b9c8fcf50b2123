"""Controller, in the order of the graph: state estimator, gait, MPC, force map."""
