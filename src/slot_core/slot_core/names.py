"""Names that a command's help needs without loading the robot."""

LEGS = ("FL", "FR", "RL", "RR")
"""Names of the legs, in the order of every array with a value for each."""
ONNX = "onnx:"
"""Prefix of a policy's name that gives the file of a network."""
