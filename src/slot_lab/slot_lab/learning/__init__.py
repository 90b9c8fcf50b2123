"""Environments of the walk and a learner. Importing it registers `SLOT-Walk-v0` with Gymnasium."""

import gymnasium

NAME = "SLOT-Walk-v0"
gymnasium.register(
    NAME,
    entry_point="slot_lab.learning.walk_env:WalkEnv",
    vector_entry_point="slot_lab.learning.vector_env:WalkVectorEnv",
)
