"""What decides: state estimator, gait, reference, MPC and force map."""
