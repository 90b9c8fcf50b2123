"""Course of the walk, and the reward of a step: a weighted sum of documented terms.

    term      value
    walking   1 while the robot has not fallen
    speed     -(speed along the course less the commanded, mean of a stride, as a share of SPEED)^2
    aside     -(distance of the torso from the course to the side, as a share of ASIDE)^2
    yaw       -(angle of the heading from the course's, mean of a stride, as a share of TURN)^2
    tilt      -(difference of roll and pitch from the gait's own, as a share of TILT)^2
    load      -(mean torque of the servos as a share of LOAD)^2
    change    -mean |change of the action since the last step|

The course is where the commanded velocity leads. Unlike the reference that a policy sees, it
does not follow a robot that falls behind or turns away, and it has no sway of the gait. The
mean of a stride leaves out the gait's own swing of 2 deg in yaw, so that nothing is won by
working against it, which sways the robot to the sides. No term is below WORST. A robot that
has fallen gets zero.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.gait.gait import moved
from slot_core.geometry import rotate, wrapped
from slot_lab.learning.task import Task

PLACE = [3, 4, 2]  # x, y, yaw in a state
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


def reward_terms(
    state: Array, stray: Array, tilt: Array, torque: Array, change: Array
) -> dict[str, Array]:
    """Terms (M,) by name of a step of M robots; a robot that has fallen gives zeros.

    state: (M, 12) as in `Estimate`; stray: (3, M) as `Course.stray`; tilt: (M, 2) roll and pitch
    of the gait, rad; torque: (M, 4) N m, of the servos; change: (M, n) of the action.
    """
    faster, aside, turn = stray
    terms = {
        "walking": np.ones(len(state)),
        "speed": -((faster / SPEED) ** 2),
        "aside": -((aside / ASIDE) ** 2),
        "yaw": -((turn / TURN) ** 2),
        "tilt": -((state[:, :2] - tilt) ** 2).sum(axis=1) / TILT**2,
        "load": -((torque.mean(axis=1) / LOAD) ** 2),
        "change": -np.abs(change).mean(axis=1),
    }
    up = ~fallen(state)
    return {
        name: np.where(up, np.maximum(values, WORST), 0.0)
        for name, values in terms.items()
    }


def fallen(state: Array) -> NDArray[np.bool_]:
    """Whether robots at states (M, 12) have fallen, or their simulation diverged."""
    up: NDArray[np.bool_] = (
        np.cos(state[:, 0]) * np.cos(state[:, 1]) > COS_FALLEN
    )
    return ~up  # also NaN


def total(terms: Mapping[str, Array]) -> Array:
    """Reward (M,) of terms (M,)."""
    return np.sum(
        [weight * terms[name] for name, weight in WEIGHTS.items()], axis=0
    )


class Course:
    """Courses of M robots, and their gaps over the last stride; a step takes `dt` of the gaits."""

    def __init__(self, task: Task, count: int) -> None:
        self._dt = task.gaits.dt
        self.place = np.zeros((count, 3))  # x, y (m), yaw (rad)
        ticks = round(task.stride.period / self._dt)
        self._gaps = np.zeros((ticks + 1, count, 3))  # the last is the newest

    def reset(self, which: NDArray[np.int64], state: Array) -> None:
        """Begin anew for the robots `which` (k,), at states (k, 12)."""
        self.place[which], self._gaps[:, which] = state[:, PLACE], 0.0

    def step(self, velocity: Array, state: Array) -> None:
        """Go on at velocities (M, 3), heading frame of the course, with the robots at (M, 12)."""
        self.place = moved(self.place, velocity, self._dt)
        gap = state[:, PLACE] - self.place
        xy, turn = rotate(gap[:, :2], -self.place[:, 2]), wrapped(gap[:, 2])
        self._gaps = np.concatenate(
            [self._gaps[1:], np.column_stack([xy, turn])[None]]
        )

    @property
    def stray(self) -> Array:
        """(3, M) of the robots from the course.

        Speed along it less its own, m/s, and the turn of the heading, rad, are means of the last
        stride; between them stands the distance to the left, m.
        """
        gained = self._gaps[-1, :, 0] - self._gaps[0, :, 0]
        return np.stack(
            [
                gained / (self._dt * (len(self._gaps) - 1)),
                self._gaps[-1, :, 1],
                self._gaps[1:, :, 2].mean(axis=0),
            ]
        )
