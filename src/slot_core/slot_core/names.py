"""Names of the legs, in the order of every array with a value for each."""

LEGS = ("FL", "FR", "RL", "RR")
