"""Course of the walk: where the commanded velocity leads, and how far robots are from it.

Unlike the reference that a policy sees, the course does not follow a robot that falls behind or
turns away, and it has no sway of the gait.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.gait.reference import moved
from slot_core.geometry import rotate, wrapped
from slot_lab.learning.task import Task

PLACE = [3, 4, 2]  # x, y, yaw in a state


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
        self._gaps = np.concatenate([self._gaps[1:], np.column_stack([xy, turn])[None]])

    @property
    def aside(self) -> Array:
        """(M,) m, of the robots from the course to the left."""
        return np.asarray(self._gaps[-1, :, 1])

    @property
    def turn(self) -> Array:
        """(M,) rad, of the robots from the course, mean of the last stride."""
        return np.asarray(self._gaps[1:, :, 2].mean(axis=0))

    @property
    def faster(self) -> Array:
        """(M,) m/s along the course, of the robots less the course, mean of the last stride."""
        gained = self._gaps[-1, :, 0] - self._gaps[0, :, 0]
        return np.asarray(gained / (self._dt * (len(self._gaps) - 1)))
