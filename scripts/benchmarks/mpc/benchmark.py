"""Speed and accuracy of the MPC's solver, on a walk and on hard cases.

Times are CPU times of a whole cycle of the controller: check, update of the problem, solve. Errors
are those of the first stage's forces, which are applied, against a dual active-set method
(`oracle.py`). The problem is the paper's, on forces.
"""

import itertools
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.harness import (
    Check,
    Progress,
    Row,
    at_least,
    at_most,
    mark_front,
    timed,
)
from benchmarks.mpc.cases import Case, hard_cases, random_case, stretched
from benchmarks.mpc.cvxpy_reference import CvxpyReference, restated
from benchmarks.mpc.oracle import optimum
from benchmarks.mpc.plots import draw
from slot_core import config
from slot_core.arrays import Array
from slot_core.control.policy import Status, TendonPlan
from slot_core.mpc.force_mpc import ForceMpc
from slot_core.mpc.settings import MpcSettings, read_mpc
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop

REQUIRES = ("cvxpy", "quadprog")
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
SOLVER = "clarabel"
HORIZON_TOLERANCE = 1e-10  # in `horizon_rows`
ITERATIONS = 50  # limit
HORIZONS = (5, 10, 15, 30, 45, 60)
STATES, RANDOM = 220, 60  # cases of the walk, random cases
SEED = 1
WRONG = 1e-3  # N, error above which an accepted solution counts as wrong
MINUTE, HOUR = 1800, 108_000  # cycles at 30 Hz
Solved = tuple[Sequence[Case], Array]  # cases, and the first forces of their optima


def run(quick: bool, out: Path, progress: Progress) -> tuple[list[Row], list[Check]]:
    """Run all measurements; the plot goes to `out/mpc.png`."""
    settings = config.replace(
        read_mpc("force_mpc"),
        {"acceptance.time_budget": np.inf, "acceptance.violation_max": 1.0},
    )
    progress("walk")
    walk, hard = walk_cases(), list(hard_and_random(settings.horizon))
    progress("optima")
    solved, of_hard = ((cases, optima(settings, cases)) for cases in (walk, hard))
    rows = []
    for tolerance in TOLERANCES:
        progress(f"tolerance {tolerance:g}")
        rows.append(solver_row(settings, tolerance, solved, of_hard))
    mark_front(rows, "median_ms", worst)
    progress("horizons")
    rows += horizon_rows(settings, walk[: 20 if quick else 100])
    progress("CVXPY")
    rows += cvxpy_rows(settings, walk[10 : 12 if quick else 18], solved[1][10:])
    progress("tendon angles")
    if not quick:
        progress("an hour of cycles")
        rows.append(hour_row(settings, walk))
    draw(rows, out / "mpc.png")
    return rows, checks(rows, settings)


def walk_cases() -> list[Case]:
    """States and previews of a walk of the Cosserat robot, from its start."""
    loop = ClosedLoop("flat", "walk", None, SEED)
    return [(tick.estimate, tick.preview) for tick in loop.run(STATES)]


def hard_and_random(stages: int) -> Iterable[Case]:
    """The named hard cases, then random states with random contacts."""
    rng = np.random.default_rng(SEED)
    yield from hard_cases(stages + 1).values()
    for _ in range(RANDOM):
        yield random_case(rng, stages + 1)


def optima(settings: MpcSettings, cases: Sequence[Case]) -> Array:
    """First forces of the optima, (n, 4, 3) N; a controller only assembles the problems."""
    mpc, found = controller(settings, 1e-6), []
    for case in cases:
        mpc.step(*case)
        found.append(optimum(mpc.problem)[0])
    return np.array(found)


def hour_row(settings: MpcSettings, walk: Sequence[Case]) -> dict[str, Any]:
    """Growth of the controller's memory over an hour of cycles at 30 Hz, after the first minute."""
    mpc, process = ForceMpc(read_robot(), settings, time.process_time), psutil.Process()
    for n, case in zip(range(HOUR), itertools.cycle(walk)):
        if n == MINUTE:
            before = process.memory_info().rss
        mpc.step(*case)
    gained = (process.memory_info().rss - before) / 2**20
    return {"kind": "hour", "cycles": HOUR, "gained_MB": gained}


def controller(settings: MpcSettings, tolerance: float) -> ForceMpc:
    """A controller whose solver has a tolerance, timed by the CPU."""
    changes = {
        "solver.tolerance_abs": tolerance,
        "solver.tolerance_rel": tolerance,
        "solver.iterations": ITERATIONS,
    }
    return ForceMpc(read_robot(), config.replace(settings, changes), time.process_time)


def solver_row(
    settings: MpcSettings, tolerance: float, walk: Solved, hard: Solved
) -> dict[str, Any]:
    """The solver at a tolerance: the walk twice (timed the second time), then the hard cases."""
    mpc = controller(settings, tolerance)
    walked, times = [plans(mpc, walk[0]) for _ in range(2)][1]
    results, hard_times = plans(mpc, hard[0])
    error, hard_error = errors(walked, walk[1]), errors(results, hard[1])
    reports = [plan.report for plan in [*walked, *results]]
    row = {"kind": "solver", "solver": SOLVER, "tolerance": tolerance}
    row |= {"median_ms": np.median(times), "p99_ms": np.quantile(times, 0.99)}
    row |= {"hard_max_ms": max(hard_times), "hard_error_max": np.nanmax(hard_error)}
    row |= {"error_median": np.median(error), "error_max": np.max(error)}
    return (
        row
        | outcomes(results, hard_error)
        | {
            "violation": max(report.violation for report in reports),
            "iterations_median": np.median([plan.report.iterations for plan in walked]),
            "iterations_max": max(report.iterations for report in reports),
            "walk_refused": len(walked) - sum(map(accepted, walked)),
        }
    )


def plans(mpc: ForceMpc, cases: Sequence[Case]) -> tuple[list[TendonPlan], list[float]]:
    """Plans of the cases and CPU times of their cycles, ms."""
    found = [timed(mpc.step, *case) for case in cases]
    return [plan for plan, _ in found], [1e3 * seconds for _, seconds in found]


def accepted(result: TendonPlan) -> bool:
    """Whether the controller accepts the result with its configured limit of the violation."""
    limit = read_mpc("force_mpc").acceptance.violation_max
    return result.status == Status.SOLVED and result.report.violation <= limit


def errors(results: Sequence[TendonPlan], exact: Array) -> Array:
    """(n,) N, largest error of the first stage's forces; NaN without a solution."""
    forces = np.array([plan.force[0] for plan in results])
    solved = [plan.status == Status.SOLVED for plan in results]
    return np.where(solved, np.abs(forces - exact).max(axis=(1, 2)), np.nan)


def outcomes(results: Sequence[TendonPlan], error: Array) -> dict[str, int]:
    """How many hard cases were accepted within `WRONG`, accepted beyond it, and refused."""
    taken = np.array([accepted(result) for result in results])
    return {
        "hard_right": int((taken & (error <= WRONG)).sum()),
        "hard_wrong": int((taken & (error > WRONG)).sum()),
        "hard_refused": int((~taken).sum()),
    }


def worst(row: Row) -> float:
    """Largest error over all cases, N; infinite if a case was refused."""
    if row["walk_refused"] or row["hard_refused"]:
        return float("inf")
    return max(row["error_max"], row["hard_error_max"])


def horizon_rows(
    settings: MpcSettings, walk: Sequence[Case]
) -> Iterable[dict[str, Any]]:
    """CPU time of a cycle over the number of stages."""
    for stages in HORIZONS:
        changes = {"horizon": stages, "acceptance.condition_max": 1e12}
        mpc = controller(config.replace(settings, changes), HORIZON_TOLERANCE)
        results, times = plans(
            mpc, [(x, stretched(ahead, stages + 1)) for x, ahead in walk]
        )
        row = {"kind": "horizon", "solver": SOLVER, "stages": stages}
        refused = sum(not accepted(result) for result in results)
        yield row | {"median_ms": np.median(times), "refused": refused}


def cvxpy_rows(
    settings: MpcSettings, cases: Sequence[Case], exact: Array
) -> Iterable[Row]:
    """CVXPY with the problem compiled once, and with the problem rebuilt in every cycle."""
    robot = read_robot()
    cached = CvxpyReference(robot, settings)
    cached.solve(cases[0][0].state, cases[0][1])
    solvers = {
        "CVXPY, cached, Clarabel": lambda x, ahead: cached.solve(x.state, ahead),
        "CVXPY, as published, SCS": lambda x, ahead: restated(
            robot, settings, x.state, ahead
        ),
    }
    for name, solve in solvers.items():
        forces, times = zip(*(timed(solve, *case) for case in cases))
        off = [
            np.abs(force[0] - optimal).max() for force, optimal in zip(forces, exact)
        ]
        row = {"kind": "cvxpy", "solver": name, "median_ms": 1e3 * np.median(times)}
        yield row | {"error_median": np.median(off), "error_max": np.max(off)}


def checks(rows: Sequence[dict[str, Any]], settings: MpcSettings) -> list[Check]:
    """The solver at the configured tolerance against the goals."""
    tolerance = settings.solver.tolerance_abs
    row = next(r for r in rows if r["kind"] == "solver" and r["tolerance"] == tolerance)
    time_of = {r["stages"]: r["median_ms"] for r in rows if r["kind"] == "horizon"}
    cached, published = (r["median_ms"] for r in rows if r["kind"] == "cvxpy")
    hour = [row["gained_MB"] for row in rows if row["kind"] == "hour"]
    return [
        *(
            at_most("growth of memory in an hour of cycles", gained, 1.0, "MB")
            for gained in hour
        ),
        at_most("error of the first forces, walk", row["error_max"], 1e-3, "N"),
        at_most(
            "error of the first forces, hard cases", row["hard_error_max"], 1e-3, "N"
        ),
        at_most(
            "hard cases refused or wrong", row["hard_refused"] + row["hard_wrong"], 0
        ),
        at_most("time of 60 stages over that of 15", time_of[60] / time_of[15], 4.5),
        at_least("faster than CVXPY, cached", cached / row["median_ms"], 2.5, "times"),
        at_least(
            "faster than CVXPY as published",
            published / row["median_ms"],
            80.0,
            "times",
        ),
    ]
