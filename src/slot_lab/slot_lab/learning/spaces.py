"""Spaces of observations and actions of the environments of the walk."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box

from slot_core.control.walk_actions import ACTIONS, CLIP
from slot_core.robot import Array
from slot_lab.learning.task import Task

SERVO_SCALE = 0.1  # rad


def observation_space(task: Task) -> Box:
    """Observations of `walk_actions.py`, and the servos' errors (4) where the task has them."""
    return Box(-CLIP, CLIP, (task.observed,), np.float32)


def action_space(task: Task) -> Box:
    """Actions of the task's kind."""
    return Box(-1.0, 1.0, (ACTIONS[task.actions],), np.float32)


def servo_error(commanded: Array, angle: Array) -> Array:
    """Observed errors (m, 4) of the servos' angles (m, 4), rad, by their scale."""
    return np.clip((commanded - angle) / SERVO_SCALE, -CLIP, CLIP)
