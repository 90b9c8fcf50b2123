"""Reference trajectory of the torso over the horizon."""

from __future__ import annotations

import numpy as np

from slot_core.robot import Array


def reference(state: Array, heading: float, velocity: Array, sway: Array, times: Array) -> Array:
    """(n, 12) [roll pitch yaw, p, omega, v] in odom at `times` (n,) s ahead.

    From where it is, the torso moves with the velocity [v_x, v_y, yaw rate] (m/s, rad/s) of its
    heading frame, turning from `heading` (rad); the gait's `sway` (n, 12) in that frame is added.
    The yaw is that of the turn which is nearest to the state's, as the state's own yaw wraps.
    """
    turns = np.round((state[2] - heading) / (2 * np.pi))
    yaw = heading + 2 * np.pi * turns + velocity[2] * times
    rows = sway.copy()
    rows[:, 2] = yaw
    rows[:, 6:8] = turn(sway[:, 6:8], yaw)
    rows[:, 8] = velocity[2]
    rows[:, 9:11] = turn(sway[:, 9:11] + velocity[:2], yaw)
    rows[:, 3:5] = state[3:5] + turn(np.tile(velocity[:2], (len(times), 1)), yaw) * times[:, None]
    return rows


def turn(vectors: Array, yaw: Array) -> Array:
    """Rotate plane vectors (n, 2) by yaw (n,), rad, counter-clockwise."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = vectors.T
    return np.column_stack([c * x - s * y, s * x + c * y])
