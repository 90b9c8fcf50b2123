"""Walks with sensors, legs and floors as users have them, under the supervisor.

Rows are sets of `sets.py`, each with walk, crawl, stand and a walk uphill, in three seeds. The
reference has none of their differences. In means over its seeds a set walks as well as the
reference, or a line of each run names the cause; what of it a set is allowed is a check. Runs that
an interrupted benchmark has left in `runs.jsonl` are kept if the revision is the same and committed.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import (
    Check,
    Outcome,
    Progress,
    Row,
    at_least,
    resumed,
)
from benchmarks.world.field_loop import DURATION, GAITS, run_set
from benchmarks.world.plots import draw
from benchmarks.world.sets import (
    FAILS,
    REFERENCE,
    REFUSED,
    STOPS,
    WALKS,
    WARNED,
    sets,
)

SEEDS = (1, 2, 3)
QUICK = (
    REFERENCE,
    "origin at the first pose",
    "IMU in g",
    "odometry at 10 Hz",
    "twist 0, covariance 0",
    "friction 0.8",
)
LIMITS = {
    "speed": (0.1, 2e-4),
    "aside": (0.1, 15.0),
    "heading": (0.1, 3.0),
    "tilt": (0.1, 2.5),
    "height": (0.0, 5.0),
    "stand": (0.0, 3.0),
}
"""Share of the reference's value, and more in m/s, mm, deg, deg, mm, by which a set may be worse.

Both are means over the seeds: the speed of one walk of 10 s uphill scatters by 3 %.
"""
Job = tuple[str, str, int, float, str]  # set, gait, seed, duration, solver


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Run every set, and judge it by the reference of its gait and seed."""
    names = QUICK if quick else tuple(sets())
    gaits, seeds = (("walk",), SEEDS[:1]) if quick else (tuple(GAITS), SEEDS)
    how = (8.0, "coarse") if quick else (DURATION, "standard")
    jobs = [
        (name, gait, seed, *how)
        for name in names
        for gait in gaits
        for seed in seeds
    ]
    found = resumed(run_job, jobs, out / "runs.jsonl", progress, dict)
    rows = judged([found[job] for job in jobs])
    draw(rows, out / "world.png")
    return rows, checks(rows)


def run_job(job: Job) -> tuple[Job, dict[str, Any]]:
    """The job and its row."""
    name, gait, seed, duration, solver = job
    return job, run_set(
        sets()[name], gait, seed, duration=duration, solver=solver
    )


def judged(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Rows with the ratio of the set's speed to the reference's, verdict and its line."""
    every, found = sets(), []
    means = {
        (name, gait): {
            measure: float(
                np.mean(
                    [
                        row[measure]
                        for row in rows
                        if (row["set"], row["gait"]) == (name, gait)
                    ]
                )
            )
            for measure in ("speed", "aside", "heading", "tilt", "height")
        }
        for name, gait in {(row["set"], row["gait"]) for row in rows}
    }
    for row in rows:
        one, gait = every[row["set"]], row["gait"]
        mean, reference = means[one.name, gait], means[REFERENCE, gait]
        causes = [x for x in row["lines"] if re.search(one.cause, x, re.I)]
        worse = worse_in(gait, mean, reference)
        verdict = verdict_of(row, bool(worse), bool(causes))
        found.append(
            {
                **row,
                "ratio": mean["speed"] / reference["speed"],
                "worse": " ".join(worse),
                "verdict": verdict,
                "allowed": verdict in one.allowed,
                "line": [*causes, *row["lines"], ""][0],
            }
        )
    return found


def worse_in(gait: str, mean: Row, reference: Row) -> list[str]:
    """Names of the means that are worse in a set than in the reference, with a gait."""
    off = {name: mean[name] - reference[name] for name in mean}
    limits = LIMITS | {"height": LIMITS.get(gait, LIMITS["height"])}
    for name in ("speed", "height"):
        off[name] = abs(off[name])
    return [
        name
        for name, value in off.items()
        if value > limits[name][0] * abs(reference[name]) + limits[name][1]
    ]


def verdict_of(row: Row, worse: bool, named: bool) -> str:
    """The verdict on a run that is worse or not; `named`: a line names the cause."""
    if not row["moved"]:
        verdict = REFUSED
    elif row["holds"] or row["ended"] not in ("WALKING", "STANDING"):
        verdict = STOPS
    else:
        verdict = WARNED if worse else WALKS
    return verdict if named or verdict == WALKS else FAILS


def checks(rows: Sequence[Row]) -> list[Check]:
    """A check for each set: the share of its runs whose verdict is allowed."""
    allowed: dict[str, list[bool]] = {}
    for row in rows:
        allowed.setdefault(row["set"], []).append(row["allowed"])
    return [
        at_least(
            f"{name}: allowed runs", 100.0 * sum(runs) / len(runs), 100.0, "%"
        )
        for name, runs in allowed.items()
    ]
