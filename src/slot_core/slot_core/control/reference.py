"""Reference trajectory of the torso over the horizon."""

from __future__ import annotations

import numpy as np

from slot_core.robot import Array


def reference(state: Array, heading: float, height: float, velocity: Array, times: Array) -> Array:
    """(n, 12) [roll pitch yaw, p, omega, v] in odom at `times` (n,) s ahead.

    The torso is level at `height` (m); it turns with the yaw rate from `heading` (rad) and moves
    from where it is with the velocity [v_x, v_y, yaw rate] (m/s, rad/s) of its heading frame.
    """
    yaw = heading + velocity[2] * times
    v_x = np.cos(yaw) * velocity[0] - np.sin(yaw) * velocity[1]
    v_y = np.sin(yaw) * velocity[0] + np.cos(yaw) * velocity[1]
    rows = np.zeros((len(times), 12))
    rows[:, 2] = yaw
    rows[:, 3] = state[3] + v_x * times
    rows[:, 4] = state[4] + v_y * times
    rows[:, 5] = height
    rows[:, 8] = velocity[2]
    rows[:, 9] = v_x
    rows[:, 10] = v_y
    return rows
