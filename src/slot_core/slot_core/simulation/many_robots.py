"""Many simulated robots of one model of the legs, advanced together on threads of one process."""

# mypy: disable-error-code="no-untyped-def"

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from slot_core.arrays import Array, checked
from slot_core.compiled import helper, unlocked_kernel
from slot_core.dynamics.handle import contents_at
from slot_core.dynamics.integrator import advance_contents
from slot_core.dynamics.lanes import in_lanes
from slot_core.dynamics.simulated_robot import KernelRobot, require_steps
from slot_core.geometry import roll_pitch_yaw
from slot_core.legs.tabulated_kernels import divergence_of, one_step
from slot_core.robot import LEGS
from slot_core.simulation.rod_robot import RodRobot

STATE, ANGLE, TENSION = slice(0, 12), slice(12, 16), slice(16, 20)
"""Columns of the motion: state as in `Estimate`, tendon angles (rad), tensions (N)."""
COLUMNS = 20


class ManyRobots:
    """Robots whose scenes and parameters may differ; each keeps its own state."""

    def __init__(self, robots: Sequence[KernelRobot], threads: int = 1) -> None:
        """Take the robots; raises ValueError if their legs are of different models."""
        self.robots = list(robots)
        self._advance = (
            _advance_rods
            if isinstance(robots[0], RodRobot)
            else _advance_tabulated
        )
        self._address = np.array([robot.handle.address for robot in robots])
        self.motion = np.zeros((len(robots), COLUMNS))
        for index, robot in enumerate(robots):
            self.replace(index, robot)
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads)

    def replace(self, index: int, robot: KernelRobot) -> None:
        """Put another robot in a place; raises ValueError for another model of the legs."""
        if robot.handle.numba_type != self.robots[0].handle.numba_type:
            raise ValueError(
                f"robot {index}: legs of another model, or with other numbers of them"
            )
        self.robots[index], self._address[index] = robot, robot.handle.address
        self.motion[index] = 0.0
        self._advance(
            robot.handle,
            self._address[index : index + 1],
            np.zeros((1, 0, 4)),
            0,
            self.motion[index : index + 1],
        )

    def advance(self, goals: Array, steps: int) -> Array:
        """Motion (M, 20) after the servos' goals (M, n, 4), rad, of `steps` steps each.

        Rows of a robot that diverged are NaN, until it is replaced. Raises ValueError for another
        shape, for angles that are not finite or outside [0, angle_max], and for a number of steps
        that is no integer or negative.
        """
        require_steps(steps)
        goals = checked("goals", goals, (len(self.robots), -1, len(LEGS)))
        most = self.robots[0].parameters.tendon.angle_max
        if goals.size and not (goals.min() >= 0.0 and goals.max() <= most):
            raise ValueError(
                f"goals: {goals.min():g} to {goals.max():g} rad, not in [0, {most:g}]"
            )
        parts = np.array_split(np.arange(len(goals)), self._threads)
        calls = [
            slice(int(part[0]), int(part[-1]) + 1)
            for part in parts
            if len(part)
        ]
        # one part is done here: to wake another thread takes longer than a step
        each = self._pool.map if len(calls) > 1 else map
        list(
            each(
                lambda part: self._advance(
                    self.robots[0].handle,
                    self._address[part],
                    goals[part],
                    steps,
                    self.motion[part],
                ),
                calls,
            )
        )
        return self.motion.copy()


@unlocked_kernel
def _advance_rods(machine, address, goals, steps, motion):
    """Advance the robots at the addresses (M,) by goals (M, n, 4); write their motion (M, 20)."""
    for r in range(address.size):
        model, state, work, start, legs, scheme = contents_at(
            machine, address[r]
        )
        fine = not math.isnan(motion[r, 0])
        for c in range(goals.shape[1]):
            for leg in range(4):
                legs.command[0, leg] = goals[r, c, leg]
            if fine:
                lanes = (in_lanes(legs),)
                _, where = advance_contents(
                    model, state, work, start, lanes, scheme, steps
                )
                fine = where < 0
        _record(motion[r], state, fine)


@unlocked_kernel
def _advance_tabulated(machine, address, goals, steps, motion):
    """As `_advance_rods`, of robots on tabulated legs."""
    for r in range(address.size):
        model, legs, state, feet, work, scheme, sides = contents_at(
            machine, address[r]
        )
        fine = not math.isnan(motion[r, 0])
        for c in range(goals.shape[1]):
            for leg in range(4):
                feet.command[leg] = goals[r, c, leg]
            for _ in range(steps):
                if fine:
                    one_step(
                        model, legs, state, feet, work, scheme, in_lanes(sides)
                    )
                    fine = divergence_of(state, model.speed_limit) < 0
        _record(motion[r], state, fine)


@helper
def _record(row, state, fine):
    """Write the motion (20,) of a robot, or NaN."""
    r, w, nan = state.rotation, state.rate, math.nan
    row[0], row[1], row[2] = roll_pitch_yaw(r) if fine else (nan, nan, nan)
    for i in range(3):
        row[3 + i] = state.position[i] if fine else nan
        row[6 + i] = (
            r[i, 0] * w[0] + r[i, 1] * w[1] + r[i, 2] * w[2] if fine else nan
        )
        row[9 + i] = state.velocity[i] if fine else nan
    for leg in range(4):
        row[12 + leg] = state.tendon_angle[leg] if fine else nan
        row[16 + leg] = state.tension[leg] if fine else nan
