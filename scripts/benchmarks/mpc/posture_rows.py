"""Speed and accuracy of the default problem, on tendon angles, with robots that stand.

Its quadratic programme is dense and small, so that a dual active-set method (quadprog) gives the
optimum of every cycle.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import quadprog

from benchmarks.harness import timed
from benchmarks.mpc.cases import Case
from slot_core import config
from slot_core.control.policy import Status
from slot_core.gait.gait import STAND
from slot_core.mpc.model import FEET
from slot_core.mpc.mpc import Mpc
from slot_core.mpc.posture_problem import PostureProblem, PostureSolver
from slot_core.mpc.settings import read_mpc
from slot_core.robot import Array, read_robot
from slot_core.simulation.closed_loop import ClosedLoop

SCENES = ("flat", "payload", "slope10")
POSES = ((0.030, 0.0, 0.0), (0.060, 0.0, 0.0), (0.040, 0.08, -0.08), (0.045, 0.0, 0.0))
TICKS = 60  # a pose is held
SEED = 1
SPREAD = (0.01, 0.15, 0.15)  # m, rad: standard deviation of the thrown postures


def rows(quick: bool) -> Iterator[dict[str, Any]]:
    """Robots that change their posture, and the same with postures thrown far off."""
    calm = [case for scene in SCENES[: 1 if quick else None] for case in standing(scene)]
    yield {"kind": "posture", "cases": "standing"} | measured(calm)
    yield {"kind": "posture", "cases": "thrown"} | measured(thrown(calm))


def standing(scene: str) -> Iterator[Case]:
    """States and previews of a robot that takes the poses in turn."""
    loop = ClosedLoop(scene, STAND, None, SEED)
    for n, tick in enumerate(loop.run(TICKS * len(POSES))):
        if n % TICKS == 0:
            loop.controller.scheduler.set_pose(np.array(POSES[n // TICKS]))
        yield tick.estimate, tick.preview


def thrown(cases: list[Case]) -> list[Case]:
    """The cases with height, roll and pitch off by random errors."""
    rng = np.random.default_rng(SEED)
    off = rng.normal(scale=SPREAD, size=(len(cases), 3))
    states = np.array([estimate.state for estimate, _ in cases])
    states[:, [5, 0, 1]] += off
    return [(dataclasses.replace(x, state=s), ahead) for (x, ahead), s in zip(cases, states)]


def measured(cases: list[Case]) -> dict[str, Any]:
    """Times of the cycles, and errors of the first angles against the optima, rad."""
    settings = config.replace(read_mpc(), {"acceptance.time_budget": math.inf})
    mpc = Mpc(read_robot(), settings, time.process_time)
    times, errors, limited, refused = [], [], 0, 0
    for case in cases:
        plan, seconds = timed(mpc.step, *case)
        times.append(1e3 * seconds)
        refused += plan.status != Status.SOLVED
        assert isinstance(mpc.problem, PostureProblem)
        exact, active = optimum(mpc.problem.qp)
        errors.append(np.abs(mpc.problem.solve().z - exact)[:FEET].max())
        limited += active
    row = {"cycles": len(cases), "limited": limited, "refused": refused}
    row |= {"median_ms": np.median(times), "p99_ms": np.quantile(times, 0.99)}
    return row | {"error_median_rad": np.median(errors), "error_max_rad": np.max(errors)}


def optimum(qp: PostureSolver) -> tuple[Array, bool]:
    """Optimum of the programme by the method of Goldfarb and Idnani, and whether a limit is active.

    Limits on the slacks alone do not count: they are active wherever no force is negative.
    """
    unit = np.eye(len(qp.c))
    bounded = np.isfinite(qp.high)
    matrix = np.vstack([-qp.G, unit, -unit[bounded]])
    least = np.concatenate([-qp.h, qp.low, -qp.high[bounded]])
    z, _, _, _, multipliers, _ = quadprog.solve_qp(qp.P, -qp.c, matrix.T.copy(), least)
    slacks = slice(len(qp.h) + qp.inputs, len(qp.h) + len(qp.c))
    multipliers[slacks] = 0.0
    return z, bool((multipliers > 0.0).any())
