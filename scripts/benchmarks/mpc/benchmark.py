"""Speed and accuracy of the MPC's solvers, on a walk and on hard cases.

Times are CPU times of a whole cycle of the controller: check, update of the problem, solve. Errors
are those of the first stage's forces, which are applied, against a dual active-set method
(`oracle.py`). The solvers are compared on the paper's problem, on forces; the default problem, on
tendon angles, has rows of its own (`posture_rows.py`).
"""

import itertools
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.harness import Check, Row, at_least, at_most
from benchmarks.mpc import posture_rows
from benchmarks.mpc.cases import Case, hard_cases, random_case, stretched
from benchmarks.mpc.cvxpy_reference import CvxpyReference
from benchmarks.mpc.oracle import optimum
from benchmarks.mpc.picture import draw
from benchmarks.mpc.restated import restated
from slot_core import config
from slot_core.control.policy import Status, TendonPlan
from slot_core.mpc import solver
from slot_core.mpc.mpc import Mpc
from slot_core.mpc.settings import MpcSettings, read_mpc
from slot_core.robot import Array, read_robot
from slot_core.simulation.closed_loop import ClosedLoop

REQUIRES = ("cvxpy", "quadprog")
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
VARIANTS = {"piqp": ("piqp multistage", "piqp ldlt")}  # with a backend
SOLVERS = tuple(variant for name in solver.SOLVERS for variant in VARIANTS.get(name, (name,)))
HORIZON_TOLERANCE = 1e-10  # in `horizon_rows`
ITERATIONS = 50  # limit
HORIZONS = (5, 10, 15, 30, 45, 60)
STATES, RANDOM = 220, 60  # cases of the walk, random cases
SEED = 1
WRONG = 1e-3  # N, error above which an accepted solution counts as wrong
MINUTE, HOUR = 1800, 108_000  # cycles at 30 Hz


def run(quick: bool, out: Path, progress: Callable[[str], None]) -> tuple[list[Row], list[Check]]:
    """Run all measurements; the picture goes to `out/mpc.png`."""
    settings = config.replace(
        read_mpc("forces"), {"acceptance.time_budget": np.inf, "acceptance.violation_max": 1.0}
    )
    progress("walk")
    walk, hard = walk_cases(), list(hard_and_random(settings.horizon))
    progress("optima")
    exact = Exact(settings, walk, hard)
    rows = []
    for name in SOLVERS:
        progress(f"solver {name}")
        rows += [solver_row(settings, name, tol, walk, hard, exact) for tol in TOLERANCES]
    mark_front(rows)
    progress("horizons")
    rows += horizon_rows(settings, walk[: 20 if quick else 100])
    progress("CVXPY")
    rows += cvxpy_rows(settings, walk[10 : 12 if quick else 18], exact.walk[10:])
    progress("tendon angles")
    rows += posture_rows.rows(quick)
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


class Exact:
    """First forces of the optima, (n, 4, 3) N."""

    def __init__(self, settings: MpcSettings, walk: Sequence[Case], hard: Sequence[Case]):
        """Solve all cases; a controller only assembles the problems."""
        self._mpc = controller(settings, "piqp multistage", 1e-6)
        self.walk, self.hard = self._optima(walk), self._optima(hard)

    def _optima(self, cases: Sequence[Case]) -> Array:
        optima = []
        for case in cases:
            self._mpc.step(*case)
            optima.append(optimum(self._mpc.problem.qp)[0])
        return np.array(optima)


def hour_row(settings: MpcSettings, walk: Sequence[Case]) -> dict[str, Any]:
    """Growth of the controller's memory over an hour of cycles at 30 Hz, after the first minute."""
    mpc, process = Mpc(read_robot(), settings, time.process_time), psutil.Process()
    for n, case in zip(range(HOUR), itertools.cycle(walk)):
        if n == MINUTE:
            before = process.memory_info().rss
        mpc.step(*case)
    gained = (process.memory_info().rss - before) / 2**20
    return {"kind": "hour", "cycles": HOUR, "gained_MB": gained}


def controller(settings: MpcSettings, variant: str, tolerance: float) -> Mpc:
    """A controller with one of `SOLVERS`, timed by the CPU."""
    name, _, backend = variant.partition(" ")
    changes = {
        "solver.name": name,
        "solver.backend": backend or settings.solver.backend,
        "solver.tolerance_abs": tolerance,
        "solver.tolerance_rel": tolerance,
        "solver.iterations": ITERATIONS,
    }
    return Mpc(read_robot(), config.replace(settings, changes), time.process_time)


def solver_row(  # noqa: PLR0917
    settings: MpcSettings,
    variant: str,
    tolerance: float,
    walk: Sequence[Case],
    hard: Sequence[Case],
    exact: Exact,
) -> dict[str, Any]:
    """One solver at one tolerance: the walk twice (timed the second time), then the hard cases."""
    mpc = controller(settings, variant, tolerance)
    walked, times = [timed(mpc, walk) for _ in range(2)][1]
    results, hard_times = timed(mpc, hard)
    error = errors(walked, exact.walk)
    return {
        "kind": "solver",
        "solver": variant,
        "tolerance": tolerance,
        "median_ms": float(np.median(times)),
        "p99_ms": float(np.quantile(times, 0.99)),
        "hard_max_ms": max(hard_times),
        "error_median": float(np.median(error)),
        "error_max": float(np.max(error)),
        "hard_error_max": float(np.nanmax(errors(results, exact.hard))),
        "violation": max(plan.report.violation for plan in [*walked, *results]),
        "iterations_median": float(np.median([plan.report.iterations for plan in walked])),
        "iterations_max": max(plan.report.iterations for plan in [*walked, *results]),
        "walk_refused": len(walked) - sum(accepted(result) for result in walked),
    } | outcomes(results, errors(results, exact.hard))


def timed(mpc: Mpc, cases: Sequence[Case]) -> tuple[list[TendonPlan], list[float]]:
    """Plans of the cases and CPU times of their cycles, ms."""
    plans, times = [], []
    for case in cases:
        start = time.process_time()
        plans.append(mpc.step(*case))
        times.append(1e3 * (time.process_time() - start))
    return plans, times


def accepted(result: TendonPlan) -> bool:
    """Whether the controller accepts the result with its configured limit of the violation."""
    limit = read_mpc("forces").acceptance.violation_max
    return result.status == Status.SOLVED and result.report.violation <= limit


def errors(results: Sequence[TendonPlan], exact: Array) -> Array:
    """(n,) N, largest error of the first stage's forces; NaN without a solution."""
    return np.array(
        [
            np.abs(result.force[0] - optimal).max() if result.status == Status.SOLVED else np.nan
            for result, optimal in zip(results, exact)
        ]
    )


def outcomes(results: Sequence[TendonPlan], error: Array) -> dict[str, int]:
    """How many hard cases were accepted within `WRONG`, accepted beyond it, and refused."""
    taken = np.array([accepted(result) for result in results])
    return {
        "hard_right": int((taken & (error <= WRONG)).sum()),
        "hard_wrong": int((taken & (error > WRONG)).sum()),
        "hard_refused": int((~taken).sum()),
    }


def mark_front(rows: list[dict[str, Any]]) -> None:
    """Mark the Pareto front: rows for which no other is both faster and more accurate."""
    for row in rows:
        row["front"] = not any(
            other["median_ms"] < row["median_ms"] and worst(other) < worst(row) for other in rows
        )


def worst(row: dict[str, Any]) -> float:
    """Largest error over all cases, N; infinite if a case was refused."""
    if row["walk_refused"] or row["hard_refused"]:
        return float("inf")
    return max(row["error_max"], row["hard_error_max"])


def horizon_rows(settings: MpcSettings, walk: Sequence[Case]) -> Iterable[dict[str, Any]]:
    """CPU time of a cycle over the number of stages."""
    for variant in SOLVERS:
        for stages in HORIZONS:
            changes = {"horizon": stages, "acceptance.condition_max": 1e12}
            longer = config.replace(settings, changes)
            mpc = controller(longer, variant, HORIZON_TOLERANCE)
            longer_walk = [(x, stretched(ahead, stages + 1)) for x, ahead in walk]
            results, times = timed(mpc, longer_walk)
            yield {
                "kind": "horizon",
                "solver": variant,
                "stages": stages,
                "median_ms": float(np.median(times)),
                "refused": sum(not accepted(result) for result in results),
            }


def cvxpy_rows(
    settings: MpcSettings, cases: Sequence[Case], exact: Array
) -> Iterable[dict[str, Any]]:
    """CVXPY with the problem compiled once, and with the problem rebuilt in every cycle."""
    robot = read_robot()
    cached = CvxpyReference(robot, settings)
    cached.solve(cases[0][0].state, cases[0][1])
    solvers = {
        "CVXPY, cached, Clarabel": lambda x, ahead: cached.solve(x.state, ahead),
        "CVXPY, as published, SCS": lambda x, ahead: restated(robot, settings, x.state, ahead),
    }
    for name, solve in solvers.items():
        errors_, times = [], []
        for case, optimal in zip(cases, exact):
            start = time.process_time()
            force = solve(*case)
            times.append(time.process_time() - start)
            errors_.append(np.abs(force[0] - optimal).max())
        yield {
            "kind": "cvxpy",
            "solver": name,
            "median_ms": 1e3 * float(np.median(times)),
            "error_median": float(np.median(errors_)),
            "error_max": float(np.max(errors_)),
        }


def checks(rows: Sequence[dict[str, Any]], settings: MpcSettings) -> list[Check]:
    """The configured solver against the goals."""
    chosen = settings.solver
    name = f"piqp {chosen.backend}" if chosen.name == "piqp" else chosen.name
    mine = [row for row in rows if row.get("solver") == name]
    row = next(r for r in mine if r["kind"] == "solver" and r["tolerance"] == chosen.tolerance_abs)
    time_of = {r["stages"]: r["median_ms"] for r in mine if r["kind"] == "horizon"}
    cached, published = (r["median_ms"] for r in rows if r["kind"] == "cvxpy")
    # the fastest other solver at the same tolerance that refuses no hard case
    rival = min(
        r["median_ms"]
        for r in rows
        if r["kind"] == "solver"
        and r["solver"] != name
        and r["tolerance"] == row["tolerance"]
        and not r["hard_refused"]
    )
    standing, thrown = (row for row in rows if row["kind"] == "posture")
    hour = [row["gained_MB"] for row in rows if row["kind"] == "hour"]
    return [
        *(at_most("growth of memory in an hour of cycles", gained, 1.0, "MB") for gained in hour),
        at_least(f"{name}: faster than the next solver", rival / row["median_ms"], 1.2, "times"),
        at_most("error of the first forces, walk", row["error_max"], 1e-3, "N"),
        at_most("error of the first forces, hard cases", row["hard_error_max"], 1e-3, "N"),
        at_most("hard cases refused or wrong", row["hard_refused"] + row["hard_wrong"], 0),
        at_most("time of 60 stages over that of 15", time_of[60] / time_of[15], 4.5),
        at_least("faster than CVXPY, cached", cached / row["median_ms"], 5.0, "times"),
        at_least("faster than CVXPY as published", published / row["median_ms"], 150.0, "times"),
        at_most("tendon angles: error of the first ones", standing["error_max_rad"], 1e-4, "rad"),
        at_most("tendon angles, thrown: error", thrown["error_max_rad"], 1e-4, "rad"),
        at_least("tendon angles, thrown: cycles with an active limit", thrown["limited"], 10),
        at_most("tendon angles: cycles refused", standing["refused"] + thrown["refused"], 0),
        at_most(
            "tendon angles: cycle over that on forces",
            standing["median_ms"] / row["median_ms"],
            1.5,
        ),
    ]
