"""Reference of the torso: where the robot is to be, and the rows of the preview."""

import numpy as np

from slot_core.arrays import Array
from slot_core.geometry import rotate, wrapped
from slot_core.matrices import norm


def moved(place: Array, velocity: Array, dt: float) -> Array:
    """Places (..., 3) x, y (m), yaw (rad) after dt (s) at velocities (..., 3), heading frame."""
    along = rotate(velocity[..., :2], place[..., 2])
    return np.asarray(
        place + dt * np.concatenate([along, velocity[..., 2:]], axis=-1)
    )


def limited(
    place: Array, robot: Array, lead: float, heading_lead: float
) -> Array:
    """Reference place (3,), at most `lead` (m) and `heading_lead` (rad) from the robot's place."""
    gap, turn = place[:2] - robot[:2], wrapped(place[2] - robot[2])
    share = min(1.0, lead / max(norm(gap), 1e-12))
    return np.append(
        robot[:2] + share * gap,
        robot[2] + np.clip(turn, -heading_lead, heading_lead),
    )


def places_ahead(place: Array, velocity: Array, dt: float) -> Array:
    """Places (n, 3) from `place` (3,) on at velocities (n, 3) of stages dt (s) long."""
    yaw = place[2] + dt * np.append(0.0, np.cumsum(velocity[:-1, 2]))
    steps = dt * rotate(velocity[:-1, :2], yaw[:-1])
    xy = place[:2] + np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.column_stack([xy, yaw])


def reference(
    state: Array, place: Array, velocity: Array, motion: Array
) -> Array:
    """Reference (n, 12) [roll pitch yaw, p, omega, v] in odom.

    place: (n, 3) x, y (m) and yaw (rad) of the reference place; velocity: (n, 3) [v_x, v_y, yaw
    rate] (m/s, rad/s) in its heading frame; motion: (n, 12), the gait's own, in that frame, is
    added. The yaw is shifted by the full turns that bring it nearest to the state's.
    """
    yaw = place[:, 2] + 2 * np.pi * np.round(
        (state[2] - place[0, 2]) / (2 * np.pi)
    )
    rows = motion.copy()
    rows[:, 2] = yaw
    rows[:, 6:8] = rotate(motion[:, 6:8], yaw)
    rows[:, 8] = velocity[:, 2]
    rows[:, 9:11] = rotate(motion[:, 9:11] + velocity[:, :2], yaw)
    rows[:, 3:5] = place[:, :2] + rotate(motion[:, 3:5], yaw)
    return rows


def mean_velocity(time: Array, pose: Array) -> Array:
    """Mean velocity (3,) [v_x, v_y, yaw rate] (m/s, rad/s) of a track, in base_link.

    time: (n,) s; pose: (n, 3) x, y (m) and yaw (rad) in odom; the yaw may wrap.
    """
    yaw = np.unwrap(pose[:, 2])
    forward, lateral = rotate(np.diff(pose[:, :2], axis=0), -yaw[:-1]).T
    return np.array([forward.sum(), lateral.sum(), yaw[-1] - yaw[0]]) / (
        time[-1] - time[0]
    )
