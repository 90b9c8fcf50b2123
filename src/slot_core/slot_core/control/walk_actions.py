"""Observation and actions of a learned policy of a stride, the same where it learns and walks.

The observation (17 + n) is, in the heading frame of the robot, each part divided by its scale:

    error (12)     reference minus state: roll, pitch, yaw, x, y, z, omega, v
    phase (2)      sine and cosine of the stride's phase
    velocity (3)   v_x, v_y, yaw rate of the reference, as a share of AMPLITUDE_MAX
    action (n)     the last one

Actions lie in [-1, 1]. `tendons` (4) are deviations of the tendon angles FL FR RL RR from the
gait's, ANGLE_MAX at one. `amplitudes` (3) change the velocity that sets the stride's amplitudes, by
AMPLITUDE_MAX at one, as the policy `place` does.
"""

import numpy as np

from slot_core.arrays import Array
from slot_core.elementary import cos, sin
from slot_core.gait.gait import Stride
from slot_core.geometry import rotate, wrapped
from slot_core.robot import LEGS

ANGLE_MAX = 0.35  # rad
AMPLITUDE_MAX = np.array([0.05, 0.05, 0.1])  # m/s, m/s, rad/s
ACTIONS = {"tendons": len(LEGS), "amplitudes": 3}
"""Number of values of an action, by its kind."""
# rad, m, SI
SCALE = np.array([0.05, 0.05, 0.1, *[0.02] * 2, 0.01, *[0.5] * 3, *[0.05] * 3])
CLIP = 5.0  # largest magnitude in an observation


def observation_size(kind: str) -> int:
    """Values of an observation with actions of a kind."""
    return len(SCALE) + 5 + ACTIONS[kind]


def observation(
    state: Array, reference: Array, phase: Array, velocity: Array, action: Array
) -> Array:
    """Observations (m, 17 + n) at states (m, 12) and references (m, 12) of `Estimate`'s order.

    phase: (m,) in [0, 1); velocity: (m, 3) of the reference, heading frame; action: (m, n), last.
    """
    error, yaw = reference - state, state[:, 2]
    error[:, 2] = wrapped(error[:, 2])
    for first in (3, 6, 9):
        error[:, first : first + 2] = rotate(error[:, first : first + 2], -yaw)
    turn = 2.0 * np.pi * phase[:, None]
    parts = [
        error / SCALE,
        sin(turn),
        cos(turn),
        velocity / AMPLITUDE_MAX,
        action,
    ]
    return np.clip(np.hstack(parts), -CLIP, CLIP)


def deviation(
    kind: str, action: Array, stride: Stride, phase: Array, velocity: Array
) -> Array:
    """Change (m, 4) of the gait's tendon angles, rad, by actions (m, n), or (1, n) for all.

    phase: (m,) and velocity: (m, 3) of the stride.
    """
    action = np.clip(action, -1.0, 1.0)
    if kind == "tendons":
        return np.broadcast_to(ANGLE_MAX * action, (len(phase), len(LEGS)))
    tables = [
        stride.stride_table(phase, velocity + change)[:, : len(LEGS)]
        for change in (AMPLITUDE_MAX * action, 0.0)
    ]
    return tables[0] - tables[1]
