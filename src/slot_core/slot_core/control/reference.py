"""Reference trajectory of the torso over the MPC's horizon."""

from __future__ import annotations

import numpy as np

from slot_core.robot import Array


def reference(state: Array, heading: float, velocity: Array, sway: Array, times: Array) -> Array:
    """Reference (n, 12) [roll pitch yaw, p, omega, v] in odom at `times` (n,) s ahead.

    The torso starts at the position of `state` (12,) and moves with `velocity` [v_x, v_y, yaw rate]
    (m/s, rad/s), expressed in the heading frame. The yaw starts at `heading` (rad). `sway` (n, 12)
    of the gait, in the heading frame, is added. The state's yaw wraps at +-pi, so the reference yaw
    is shifted by the number of full turns that brings it nearest to the state's.
    """
    turns = np.round((state[2] - heading) / (2 * np.pi))
    yaw = heading + 2 * np.pi * turns + velocity[2] * times
    rows = sway.copy()
    rows[:, 2] = yaw
    rows[:, 6:8] = rotate(sway[:, 6:8], yaw)
    rows[:, 8] = velocity[2]
    rows[:, 9:11] = rotate(sway[:, 9:11] + velocity[:2], yaw)
    rows[:, 3:5] = state[3:5] + rotate(np.tile(velocity[:2], (len(times), 1)), yaw) * times[:, None]
    return rows


def rotate(vectors: Array, yaw: Array) -> Array:
    """Rotate plane vectors (n, 2) by yaw (n,), rad, counter-clockwise."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = vectors.T
    return np.column_stack([c * x - s * y, s * x + c * y])
