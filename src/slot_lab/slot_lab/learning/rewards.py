"""Reward of a step of the walk: a weighted sum of documented terms.

    term      value
    walking   1 while the robot has not fallen
    speed     -(speed along the course less the commanded, mean of a stride, as a share of SPEED)^2
    aside     -(distance of the torso from the course to the side, as a share of ASIDE)^2
    yaw       -(angle of the heading from the course's, mean of a stride, as a share of TURN)^2
    tilt      -(difference of roll and pitch from the gait's own, as a share of TILT)^2
    load      -(mean torque of the servos as a share of LOAD)^2
    change    -mean |change of the action since the last step|

The course is that of `course.py`. The mean of a stride leaves out the gait's own swing of 2 deg in
yaw, so that nothing is won by working against it, which sways the robot to the sides. No term is
below WORST. A robot that has fallen gets zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array

SPEED = 0.005  # m/s
ASIDE = 0.005  # m
TURN, TILT = 0.01, 0.1  # rad
LOAD = 0.7  # N m, half of what the servo can hold at 11.1 V
WORST = -4.0
COS_FALLEN = math.cos(0.5)  # of the tilt, `tilt_max` of config/supervisor.yaml
WEIGHTS = {
    "walking": 1.0,
    "speed": 0.3,
    "aside": 1.5,
    "yaw": 0.5,
    "tilt": 0.1,
    "load": 0.05,
    "change": 0.3,
}


class Transition(NamedTuple):
    """One step of M robots, as the reward needs it."""

    state: Array  # (M, 12) as in `Estimate`
    faster: Array  # (M,) m/s, than the course
    aside: Array  # (M,) m, from the course
    turn: Array  # (M,) rad, from the course
    tilt: Array  # (M, 2) roll and pitch of the gait, rad
    torque: Array  # (M, 4) N m, of the servos
    change: Array  # (M, n) of the action


def reward_terms(walked: Transition) -> dict[str, Array]:
    """Terms (M,) by name; a robot that has fallen gives zeros."""
    state = walked.state
    terms = {
        "walking": np.ones(len(state)),
        "speed": -((walked.faster / SPEED) ** 2),
        "aside": -((walked.aside / ASIDE) ** 2),
        "yaw": -((walked.turn / TURN) ** 2),
        "tilt": -((state[:, :2] - walked.tilt) ** 2).sum(axis=1) / TILT**2,
        "load": -((walked.torque.mean(axis=1) / LOAD) ** 2),
        "change": -np.abs(walked.change).mean(axis=1),
    }
    up = ~fallen(state)
    return {
        name: np.where(up, np.maximum(values, WORST), 0.0)
        for name, values in terms.items()
    }


def fallen(state: Array) -> NDArray[np.bool_]:
    """Whether robots at states (M, 12) have fallen, or their simulation diverged."""
    up: NDArray[np.bool_] = np.cos(state[:, 0]) * np.cos(state[:, 1]) > COS_FALLEN
    return ~up  # also NaN


def total(terms: Mapping[str, Array]) -> Array:
    """Reward (M,) of terms (M,)."""
    return np.sum([weight * terms[name] for name, weight in WEIGHTS.items()], axis=0)
