"""Speed and accuracy of the MPC's solver, on a walk and on hard cases.

Times are CPU times of a whole cycle of the controller: check, update of the problem, solve. Errors
are taken from the first stage's forces, which are applied, against a dual active-set method
(`references.py`). The problem is the paper's, on forces.
"""

import math
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import (
    Check,
    Outcome,
    Progress,
    Row,
    at_least,
    at_most,
    timed,
)
from benchmarks.mpc.cases import Case, hard_cases, random_case, stretched
from benchmarks.mpc.references import optimum, restated
from benchmarks.plots import CostCurve, draw_error_over_cost
from slot_core import config
from slot_core.arrays import Array
from slot_core.control.policy import Status, TendonPlan
from slot_core.drawing import palette
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
# cases, and the first forces of their optima
Solved = tuple[Sequence[Case], Array]


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Run all measurements; the plot goes to `out/mpc.png`."""
    settings = config.replace(
        read_mpc(),
        {"acceptance.time_budget": np.inf, "acceptance.violation_max": 1.0},
    )
    progress("walk")
    walk = [
        (tick.estimate, tick.preview)
        for tick in ClosedLoop("flat", "walk", None, SEED).run(STATES)
    ]
    rng, stages = np.random.default_rng(SEED), settings.horizon + 1
    hard = [*hard_cases(stages).values()]
    hard += [random_case(rng, stages) for _ in range(RANDOM)]
    progress("optima")
    solved, of_hard = (
        (cases, optima(settings, cases)) for cases in (walk, hard)
    )
    rows = []
    for tolerance in TOLERANCES:
        progress(f"tolerance {tolerance:g}")
        rows.append(solver_row(settings, tolerance, solved, of_hard))
    progress("horizons")
    rows += horizon_rows(settings, walk[: 20 if quick else 100])
    progress("CVXPY")
    rows.append(
        cvxpy_row(settings, walk[10 : 12 if quick else 18], solved[1][10:])
    )
    draw(rows, out / "mpc.png")
    return rows, checks(rows, settings)


def draw(rows: Sequence[Row], path: Path) -> None:
    """Write the plot: largest error over CPU time of a cycle, beside CVXPY's on the walk alone."""
    runs = [
        (row["median_ms"], worst(row), f"{row['tolerance']:g}")
        for row in rows
        if row["kind"] == "solver" and worst(row) < math.inf
    ]
    [peer] = (row for row in rows if row["kind"] == "cvxpy")
    series = [
        CostCurve("Clarabel; numbers: tolerance", "o", palette.TRUE, (), runs),
        CostCurve(
            f"{peer['solver']}; on the walk alone",
            "s",
            palette.SECONDARY,
            (),
            [(peer["median_ms"], peer["error_max"], "")],
        ),
    ]
    draw_error_over_cost(
        series,
        path,
        xlabel="CPU ms per cycle of the controller, median of a walk",
        ylabel="largest error of a first force, walk and hard cases, N",
    )


def optima(settings: MpcSettings, cases: Sequence[Case]) -> Array:
    """First forces of the optima, (n, 4, 3) N; a controller only assembles the problems."""
    mpc, found = controller(settings, 1e-6), []
    for case in cases:
        mpc.step(*case)
        found.append(optimum(mpc.problem)[0])
    return np.array(found)


def controller(settings: MpcSettings, tolerance: float) -> ForceMpc:
    """A controller whose solver has a tolerance, timed by the CPU."""
    changes = {
        "solver.tolerance_abs": tolerance,
        "solver.tolerance_rel": tolerance,
        "solver.iterations": ITERATIONS,
    }
    return ForceMpc(
        read_robot(), config.replace(settings, changes), time.process_time
    )


def solver_row(
    settings: MpcSettings, tolerance: float, walk: Solved, hard: Solved
) -> dict[str, Any]:
    """The solver at a tolerance: the walk twice (timed the second time), then the hard cases."""
    mpc = controller(settings, tolerance)
    walked, times = [plans(mpc, walk[0]) for _ in range(2)][1]
    results, hard_times = plans(mpc, hard[0])
    error, hard_error = errors(walked, walk[1]), errors(results, hard[1])
    reports = [plan.report for plan in [*walked, *results]]
    taken = np.array([accepted(result) for result in results])
    return {
        "kind": "solver",
        "solver": SOLVER,
        "tolerance": tolerance,
        "median_ms": np.median(times),
        "p99_ms": np.quantile(times, 0.99),
        "hard_max_ms": max(hard_times),
        "hard_error_max": np.nanmax(hard_error),
        "error_median": np.median(error),
        "error_max": np.max(error),
        "hard_right": int((taken & (hard_error <= WRONG)).sum()),
        "hard_wrong": int((taken & (hard_error > WRONG)).sum()),
        "hard_refused": int((~taken).sum()),
        "violation": max(report.violation for report in reports),
        "iterations_median": np.median(
            [plan.report.iterations for plan in walked]
        ),
        "iterations_max": max(report.iterations for report in reports),
        "walk_refused": len(walked) - sum(map(accepted, walked)),
    }


def plans(
    mpc: ForceMpc, cases: Sequence[Case]
) -> tuple[list[TendonPlan], list[float]]:
    """Plans of the cases and CPU times of their cycles, ms."""
    found = [timed(mpc.step, *case) for case in cases]
    return [plan for plan, _ in found], [1e3 * seconds for _, seconds in found]


def accepted(result: TendonPlan) -> bool:
    """Whether the controller accepts the result with its configured limit of the violation."""
    return (
        result.status == Status.SOLVED
        and result.report.violation <= read_mpc().acceptance.violation_max
    )


def errors(results: Sequence[TendonPlan], exact: Array) -> Array:
    """(n,) N, largest error of the first stage's forces; NaN without a solution."""
    forces = np.array([plan.force[0] for plan in results])
    solved = [plan.status == Status.SOLVED for plan in results]
    return np.where(solved, np.abs(forces - exact).max(axis=(1, 2)), np.nan)


def worst(row: Row) -> float:
    """Largest error over all cases, N; infinite if a case was refused."""
    if row["walk_refused"] or row["hard_refused"]:
        return math.inf
    return max(row["error_max"], row["hard_error_max"])


def horizon_rows(
    settings: MpcSettings, walk: Sequence[Case]
) -> Iterable[dict[str, Any]]:
    """CPU time of a cycle over the number of stages."""
    for stages in HORIZONS:
        mpc = controller(
            config.replace(settings, {"horizon": stages}), HORIZON_TOLERANCE
        )
        results, times = plans(
            mpc, [(x, stretched(ahead, stages + 1)) for x, ahead in walk]
        )
        yield {
            "kind": "horizon",
            "solver": SOLVER,
            "stages": stages,
            "median_ms": np.median(times),
            "refused": sum(not accepted(result) for result in results),
        }


def cvxpy_row(
    settings: MpcSettings, cases: Sequence[Case], exact: Array
) -> Row:
    """CVXPY with SCS, the problem rebuilt in every cycle, as published."""
    off, times, robot = [], [], read_robot()
    for (estimate, preview), optimal in zip(cases, exact):
        forces, seconds = timed(
            restated, robot, settings, estimate.state, preview
        )
        off.append(np.abs(forces[0] - optimal).max())
        times.append(1e3 * seconds)
    return {
        "kind": "cvxpy",
        "solver": "CVXPY, as published, SCS",
        "median_ms": np.median(times),
        "error_median": np.median(off),
        "error_max": np.max(off),
    }


def checks(
    rows: Sequence[dict[str, Any]], settings: MpcSettings
) -> list[Check]:
    """The solver at the configured tolerance against the goals."""
    tolerance = settings.solver.tolerance_abs
    row = next(
        r for r in rows if r["kind"] == "solver" and r["tolerance"] == tolerance
    )
    time_of = {
        r["stages"]: r["median_ms"] for r in rows if r["kind"] == "horizon"
    }
    [published] = (r["median_ms"] for r in rows if r["kind"] == "cvxpy")
    return [
        at_most("error of the first forces, walk", row["error_max"], 1e-3, "N"),
        at_most(
            "error of the first forces, hard cases",
            row["hard_error_max"],
            1e-3,
            "N",
        ),
        at_most(
            "hard cases refused or wrong",
            row["hard_refused"] + row["hard_wrong"],
            0,
        ),
        at_most("time of 60 stages over 15", time_of[60] / time_of[15], 4.5),
        at_least(
            "faster than CVXPY as published",
            published / row["median_ms"],
            80.0,
            "times",
        ),
    ]
