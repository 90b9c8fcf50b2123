"""The paper's perturbations as published: the problem of the policy `paper_code` on its own model.

The front legs change roles every 2.5 s. Fifteen steps solve and apply u_0, five hold it. Over the
first three steps every applied f_z is at least m g / 4 + 0.2 N. Problem, model and the raised
forces are those of the authors' published walk; references, initial states and cycles are the
paper's. The authors' script for the table itself is not available. The 5 ms lag of their actuators
is left out. They solve with SCS at its default accuracy; here Clarabel computes the optimum.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from benchmarks.perturbations.cases import (
    DT,
    HEIGHT,
    NOISE,
    P_Z,
    SPEED,
    V_X,
    PerturbedRun,
)
from slot_core.arrays import Array
from slot_core.mpc.model import FEET, STATES
from slot_core.mpc.paper_problem import AXES, FRONT, PaperProblem
from slot_core.mpc.settings import PaperMpcSettings
from slot_core.robot import GRAVITY, RobotParameters

GAIT_PERIOD = 5.0  # s
RAISED_FORCE, RAISED_STEPS = 0.2, 3  # N per leg beyond m g / 4, in the first steps
SOLVED_STEPS, HELD_STEPS = 15, 5
MOST_STATE = 1.0  # SI, limit of states with noise; the authors' limit is unknown


def reference() -> Array:
    """(12,) the paper's reference."""
    target = np.zeros(STATES)
    target[[P_Z, V_X]] = HEIGHT, SPEED
    return target


def run_published(  # noqa: PLR0917
    robot: RobotParameters,
    settings: PaperMpcSettings,
    change: Mapping[int, float],
    duration: float,
    noise: np.random.Generator | None = None,
    raised: float = RAISED_FORCE,
) -> PerturbedRun:
    """Run a case over whole cycles of 15 solved and 5 held steps; `noise` is added to the state.

    raised: N, by which every leg pushes beyond m g / 4, at least, in the first steps.
    """
    problem = PaperProblem(robot, settings)
    model, target = problem.predict(DT), reference()
    state, entries, infeasible = np.zeros(STATES), [], 0
    for place, value in change.items():
        state[place] = value
    cycle = SOLVED_STEPS + HELD_STEPS
    force = np.zeros((FEET, AXES))
    for step in range(int(duration / (cycle * DT)) * cycle):
        time = step * DT
        if step % cycle < SOLVED_STEPS:
            pulled = FRONT[int(time % GAIT_PERIOD >= GAIT_PERIOD / 2)]
            problem.set(state, target, pulled, DT)
            found = problem.solve()
            infeasible += bool(found.fault)
            force = problem.forces(found.z)[0]
            entries.append((time, problem.cost(found.z), state))
        if step < RAISED_STEPS:
            force[:, 2] = np.maximum(
                force[:, 2], problem.mass * GRAVITY / FEET + raised
            )
        state = model.a @ state + model.b @ force.ravel() + model.drift
        if noise is not None:
            state = np.clip(
                state + NOISE * noise.normal(size=STATES), -MOST_STATE, MOST_STATE
            )
    return PerturbedRun.of(*zip(*entries), infeasible)
