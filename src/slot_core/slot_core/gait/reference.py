"""Motion of the torso in the plane: its reference over the MPC's horizon, its mean velocity."""

from __future__ import annotations

import numpy as np

from slot_core.geometry import rotate
from slot_core.robot import Array


def reference(state: Array, heading: float, velocity: Array, motion: Array, times: Array) -> Array:
    """Reference (n, 12) [roll pitch yaw, p, omega, v] in odom at `times` (n,) s ahead.

    The torso starts at the position of `state` (12,) and moves with `velocity` [v_x, v_y, yaw rate]
    (m/s, rad/s), expressed in the heading frame. The yaw starts at `heading` (rad). `motion` (n,
    12), the gait's own, in the heading frame, is added. The state's yaw wraps at +-pi, so the
    reference yaw is shifted by the number of full turns that brings it nearest to the state's.
    """
    turns = np.round((state[2] - heading) / (2 * np.pi))
    yaw = heading + 2 * np.pi * turns + velocity[2] * times
    rows = motion.copy()
    rows[:, 2] = yaw
    rows[:, 6:8] = rotate(motion[:, 6:8], yaw)
    rows[:, 8] = velocity[2]
    rows[:, 9:11] = rotate(motion[:, 9:11] + velocity[:2], yaw)
    rows[:, 3:5] = state[3:5] + rotate(velocity[:2], yaw) * times[:, None]
    return rows


def mean_velocity(time: Array, pose: Array) -> Array:
    """Mean velocity (3,) [v_x, v_y, yaw rate] (m/s, rad/s) of a track, in base_link.

    time: (n,) s; pose: (n, 3) x, y (m) and yaw (rad) in odom; the yaw may wrap.
    """
    yaw = np.unwrap(pose[:, 2])
    forward, lateral = rotate(np.diff(pose[:, :2], axis=0), -yaw[:-1]).T
    return np.array([forward.sum(), lateral.sum(), yaw[-1] - yaw[0]]) / (time[-1] - time[0])
