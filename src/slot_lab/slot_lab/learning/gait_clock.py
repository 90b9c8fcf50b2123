"""Gait of many robots that start to walk from the posture `stand`, as the gait scheduler's.

It costs little per robot: it knows one gait and two stages, no path and no stop. At the tick
k since a robot's start, t = k dt:

    velocity   v_k = v_k-1 + clip(v_wanted - v_k-1, -a dt, a dt)
    phase      p_k = p_k-1 + dt / period, modulo 1
    place      advanced by v_k; at most `lead` and `heading_lead` ahead of the robot
    rows       (1 - w) standing + w stride_table(p_k, v_k), w = t / transition, at most 1

The stance height rises from the posture's to the stride's at `lift_speed`. A row has angles
(4, rad), normal forces (4, N) and the motion of the torso (12).
"""

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.control.force_map import read_springs
from slot_core.gait.gait import STAND, Posture, moved, reference
from slot_core.geometry import wrapped
from slot_core.robot import LEGS
from slot_lab.learning.rewards import PLACE
from slot_lab.learning.task import Task

COUNT = len(LEGS)


class GaitClock:
    """Phases, velocities and reference places of M robots.

    A step takes `dt` of the gaits. `velocity` (M, 3) is in m/s, m/s, rad/s in the heading
    frame, `phase` (M,) in [0, 1).
    """

    def __init__(self, task: Task, count: int) -> None:
        self._stride, self._gaits = task.stride, task.gaits
        s, stand = task.gaits, task.gaits.find(STAND)
        assert isinstance(stand, Posture)
        # Tables over the time since the start, up to the end of blend and lift.
        rise = task.stride.height - stand.height
        longest = max(s.transition, abs(rise) / s.lift_speed)
        time = s.dt * np.arange(3 + round(longest / s.dt))
        self._weight = np.clip(time / max(s.transition, 1e-9), 0.0, 1.0)
        self._height = stand.height + np.clip(
            rise, -s.lift_speed * time, s.lift_speed * time
        )
        springs, robot = read_springs(), task.robot
        share = np.full(COUNT, robot.weight / COUNT)
        self._standing = np.array(
            [
                springs.angle(share, robot.clamp_heights(h, 0.0, 0.0))
                for h in self._height
            ]
        )  # (ticks, 4) rad
        self._rates = s.dt * np.array(
            [s.acceleration, s.acceleration, s.turn_acceleration]
        )
        self._tick = np.zeros(count, dtype=int)
        self._wanted = np.zeros((count, 3))
        self.velocity = np.zeros((count, 3))  # m/s, rad/s, heading frame
        self.phase = np.zeros(count)  # in [0, 1)
        self._place = np.zeros((count, 3))  # x, y, yaw
        self._now = self._next = np.zeros((count, 20))  # blended rows

    def reset(
        self, which: NDArray[np.int64], velocity: Array, state: Array
    ) -> None:
        """Start robots anew.

        which: (k,) indices; velocity: (k, 3) that they shall reach; state: (k, 12), as in
        `Estimate`.
        """
        self._tick[which], self._wanted[which] = 0, velocity
        self.velocity[which], self.phase[which] = 0.0, 0.0
        self._place[which] = state[:, PLACE]
        self._now = self._rows(0, self.velocity, self.phase)
        self._look_ahead()

    def step(self, state: Array) -> None:
        """Advance by a step, with the robots at states (M, 12)."""
        self.velocity, self.phase, ahead = self._later
        first = self._tick == 0
        self._tick += 1
        gap, turn = (
            ahead[:, :2] - state[:, 3:5],
            wrapped(ahead[:, 2] - state[:, 2]),
        )
        share = np.minimum(
            1.0, self._gaits.lead / np.maximum(np.hypot(*gap.T), 1e-12)
        )
        most = self._gaits.heading_lead
        heading = state[:, 2] + np.clip(turn, -most, most)
        place = np.column_stack([state[:, 3:5] + share[:, None] * gap, heading])
        self._place = np.where(first[:, None], state[:, PLACE], place)
        self._now = self._next
        self._look_ahead()

    def _look_ahead(self) -> None:
        """Compute velocity, phase, place and row of the next tick."""
        change = np.clip(
            self._wanted - self.velocity, -self._rates, self._rates
        )
        velocity, dt = self.velocity + change, self._gaits.dt
        phase = (self.phase + dt / self._stride.period) % 1.0
        self._later = velocity, phase, moved(self._place, velocity, dt)
        self._next = self._rows(1, velocity, phase)

    def _rows(self, ticks: int, velocity: Array, phase: Array) -> Array:
        """Rows (M, 20) of the gait so many ticks ahead: angles, forces, motion of the torso."""
        tick = np.minimum(self._tick + ticks, len(self._weight) - 1)
        weight = self._weight[tick][:, None]
        rows = self._stride.stride_table(phase, velocity)
        rows[:, 13] += self._height[tick] - self._stride.height
        standing = np.zeros_like(rows)
        standing[:, :COUNT], standing[:, 13] = (
            self._standing[tick],
            self._height[tick],
        )
        return np.asarray((1.0 - weight) * standing + weight * rows)

    @property
    def angles(self) -> Array:
        """(2, M, 4) rad, of the gait now and a step later."""
        return np.stack([self._now[:, :COUNT], self._next[:, :COUNT]])

    @property
    def reference(self) -> Array:
        """(M, 12) reference of the torso, as in `GaitPreview`; yaw may be turned by full turns."""
        return reference(
            np.zeros(12), self._place, self.velocity, self._now[:, 8:]
        )

    def ahead(self) -> list[tuple[Array, Array]]:
        """Phases (M,) and velocities (M, 3) now and a step later."""
        velocity, phase, _ = self._later
        return [(self.phase, self.velocity), (phase, velocity)]
