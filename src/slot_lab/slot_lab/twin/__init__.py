"""The twin: recorded tendon angles on the simulated robot, and parameters that explain a bag."""
