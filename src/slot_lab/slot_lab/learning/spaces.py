"""Spaces of observations and actions of the environments of the walk, and their mirror images."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box
from scipy.linalg import block_diag

from slot_core.arrays import Array
from slot_core.control.walk_actions import ACTIONS, CLIP
from slot_core.gait.gait import LEFT_RIGHT
from slot_core.robot import LEGS
from slot_lab.learning.network import Mirror
from slot_lab.learning.task import Task

SERVO_SCALE = 0.1  # rad
MIRRORED_STATE = np.array(
    [-1.0, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1]
)  # factors, as in `Estimate`
MIRRORED_VELOCITY = np.array([1.0, -1.0, -1.0])
HALF_STRIDE = -np.ones(2)  # factors of the phase's sine and cosine


def observation_space(task: Task) -> Box:
    """Observations of `walk_actions.py`, and the servos' errors (4) where the task has them."""
    return Box(-CLIP, CLIP, (task.observed,), np.float32)


def action_space(task: Task) -> Box:
    """Actions of the task's kind."""
    return Box(-1.0, 1.0, (ACTIONS[task.actions],), np.float32)


def mirror_of(task: Task) -> Mirror:
    """Left and right exchanged, half a stride later, which is the same gait on the same robot."""
    legs = np.eye(len(LEGS))[LEFT_RIGHT]
    action = {"tendons": legs, "amplitudes": np.diag(MIRRORED_VELOCITY)}[task.actions]
    factors = np.concatenate([MIRRORED_STATE, HALF_STRIDE, MIRRORED_VELOCITY])
    return Mirror(block_diag(np.diag(factors), action, *[legs] * task.servos), action)


def servo_error(commanded: Array, angle: Array) -> Array:
    """Observed errors (m, 4) of the servos' angles (m, 4), rad, by their scale."""
    return np.clip((commanded - angle) / SERVO_SCALE, -CLIP, CLIP)
