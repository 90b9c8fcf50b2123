"""Search of strides on the simulated robot, and identification of what a stride does."""
