"""Reward of a step of the walk: a weighted sum of documented terms.

    term      value
    walking   1 while the robot has not fallen
    along     -|distance of the torso from the course along its heading|, as a share of ALONG
    aside     -(distance of the torso from the course to the side, as a share of ASIDE)^2
    yaw       -(angle of the heading from the course's, as a share of TURN)^2
    tilt      -(difference of roll and pitch from the gait's own, as a share of TILT)^2
    load      -(mean torque of the servos as a share of LOAD)^2
    change    -mean |change of the action since the last step|

The course is where the commanded velocity has led: unlike the reference that the policy sees, it
does not follow a robot that falls behind or turns away, and it has no sway of the gait. Only in the
first STARTING it stays beside the robot: every gait loses 27 mm as it starts, and a policy that
catches up with them strays to the side. To the side and in yaw a robot sways by more than it strays: in the mean of a square what it
strays counts whatever the sway, in that of a magnitude hardly at all. No term is below WORST. A
robot that has fallen gets zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slot_core.gait.reference import moved
from slot_core.geometry import rotate, wrapped
from slot_core.robot import Array

ALONG, ASIDE = 0.03, 0.005  # m
TURN, TILT = 0.02, 0.1  # rad
LOAD = 0.7  # N m, half of what the servo can hold at 11.1 V
WORST = -4.0
STARTING = 2.0  # s
COS_FALLEN = math.cos(0.5)  # of the tilt, `tilt_max` of config/supervisor.yaml
WEIGHTS = {
    "walking": 1.0, "along": 0.3, "aside": 1.0, "yaw": 0.5, "tilt": 0.1, "load": 0.05,
    "change": 0.3,
}  # fmt: skip


class Walked(NamedTuple):
    """What happened in a step, of M robots."""

    state: Array  # (M, 12) as in `Estimate`
    course: Array  # (M, 3) x, y (m), yaw (rad)
    tilt: Array  # (M, 2) roll and pitch of the gait, rad
    torque: Array  # (M, 4) N m, of the servos
    change: Array  # (M, n) of the action


def next_course(course: Array, velocity: Array, state: Array, time: Array, dt: float) -> Array:
    """The course (M, 3) dt (s) later, at velocities (M, 3), states (M, 12) and times (M,), s."""
    course = moved(course, velocity, dt)
    yaw = course[:, 2]
    gap = rotate(state[:, 3:5] - course[:, :2], -yaw)[:, 0]
    along = np.where(time < STARTING, gap, 0.0)[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
    return np.column_stack([course[:, :2] + along, yaw])


def reward_terms(walked: Walked) -> dict[str, Array]:
    """Terms (M,) by name; a robot that has fallen gives zeros."""
    state, course = walked.state, walked.course
    gap = np.abs(rotate(state[:, 3:5] - course[:, :2], -course[:, 2]))
    terms = {
        "walking": np.ones(len(state)),
        "along": -gap[:, 0] / ALONG,
        "aside": -((gap[:, 1] / ASIDE) ** 2),
        "yaw": -((wrapped(state[:, 2] - course[:, 2]) / TURN) ** 2),
        "tilt": -((state[:, :2] - walked.tilt) ** 2).sum(axis=1) / TILT**2,
        "load": -((walked.torque.mean(axis=1) / LOAD) ** 2),
        "change": -np.abs(walked.change).mean(axis=1),
    }
    up = ~fallen(state)
    return {name: np.where(up, np.maximum(values, WORST), 0.0) for name, values in terms.items()}


def fallen(state: Array) -> NDArray[np.bool_]:
    """Whether robots at states (M, 12) have fallen, or their simulation diverged."""
    up: NDArray[np.bool_] = np.cos(state[:, 0]) * np.cos(state[:, 1]) > COS_FALLEN
    return ~up  # also NaN


def total(terms: Mapping[str, Array]) -> Array:
    """Reward (M,) of terms (M,)."""
    return np.sum([weight * terms[name] for name, weight in WEIGHTS.items()], axis=0)
