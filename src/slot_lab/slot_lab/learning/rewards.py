"""Reward of a step of the walk: a weighted sum of documented terms, each of some 1 at most.

    term      value
    walking   1 while the robot has not fallen
    place     -distance of the torso from its reference place, as a share of `lead`
    yaw       -angle of the heading from the reference, as a share of `heading_lead`
    way       way along the commanded direction in the step, as a share of the commanded one, -1 to
              1; without a speed: 0
    tilt      -(difference of roll and pitch from the gait's own, as a share of TILT)^2, at least -4
    load      -(mean torque of the servos as a share of LOAD)^2, at least -4
    change    -mean |change of the action since the last step|

A robot that has fallen gets zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slot_core.gait.gait import GaitSettings
from slot_core.geometry import rotate, wrapped
from slot_core.robot import Array

TILT = 0.1  # rad
LOAD = 0.7  # N m, half of what the servo can hold at 11.1 V
WORST = 4.0
SLOW = 1e-3  # m/s, below which there is no direction
COS_FALLEN = math.cos(0.5)  # of the tilt, `tilt_max` of config/supervisor.yaml
WEIGHTS = {
    "walking": 1.0, "place": 1.0, "yaw": 0.5, "way": 0.5, "tilt": 0.1, "load": 0.05, "change": 0.05,
}  # fmt: skip


class Walked(NamedTuple):
    """What happened in a step, of M robots."""

    before: Array  # (M, 12) state, as in `Estimate`
    state: Array  # (M, 12)
    reference: Array  # (M, 12)
    velocity: Array  # (M, 3) of the reference, heading frame, m/s and rad/s
    torque: Array  # (M, 4) N m, of the servos
    change: Array  # (M, n) of the action


def reward_terms(walked: Walked, gaits: GaitSettings) -> dict[str, Array]:
    """Terms (M,) by name; a robot that has fallen gives zeros."""
    error, speed = walked.reference - walked.state, np.hypot(*walked.velocity[:, :2].T)
    moved = rotate((walked.state - walked.before)[:, 3:5], -walked.reference[:, 2])
    along = (moved * walked.velocity[:, :2]).sum(axis=1) / np.maximum(speed, 1e-9) ** 2 / gaits.dt
    terms = {
        "walking": np.ones(len(error)),
        "place": -np.hypot(*error[:, 3:5].T) / gaits.lead,
        "yaw": -np.abs(wrapped(error[:, 2])) / gaits.heading_lead,
        "way": np.where(speed > SLOW, np.clip(along, -1.0, 1.0), 0.0),
        "tilt": -np.minimum((error[:, :2] ** 2).sum(axis=1) / TILT**2, WORST),
        "load": -np.minimum((walked.torque.mean(axis=1) / LOAD) ** 2, WORST),
        "change": -np.abs(walked.change).mean(axis=1),
    }
    up = ~fallen(walked.state)
    return {name: np.where(up, values, 0.0) for name, values in terms.items()}


def fallen(state: Array) -> NDArray[np.bool_]:
    """Whether robots at states (M, 12) have fallen, or their simulation diverged."""
    up: NDArray[np.bool_] = np.cos(state[:, 0]) * np.cos(state[:, 1]) > COS_FALLEN
    return ~up  # also NaN


def total(terms: Mapping[str, Array]) -> Array:
    """Reward (M,) of terms (M,)."""
    return np.sum([weight * terms[name] for name, weight in WEIGHTS.items()], axis=0)
