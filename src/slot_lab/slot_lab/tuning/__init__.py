"""Search of strides on the simulated robot, and identification of a stride's motion."""
