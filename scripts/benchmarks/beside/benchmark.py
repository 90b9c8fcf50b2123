"""Speed of the project beside an earlier revision of it, measured in one run.

The earlier revision is cloned to `OUT/before` and set up there, once. The benchmarks of both run in
turn, and every figure is the median of the repeats; `-`: the earlier one has no such row. The goals
depend on the machine; how a figure compares with the earlier one depends less on it. With --quick
there is one repeat, of `robot` alone; it takes three minutes, and some more the first time, when it
sets the earlier revision up.
"""

import json
import math
import os
import statistics
import subprocess
from functools import partial
from pathlib import Path
from typing import NamedTuple

from benchmarks.harness import (
    ROOT,
    BenchmarkError,
    Outcome,
    Progress,
    Row,
    at_least,
    at_most,
)
from benchmarks.servo.age import BUSY

REQUIRES = ("gymnasium",)
REVISION = "f545c706"  # the earlier one
REPEATS = 3
KEPT = (
    "HOME",
    "PATH",
    "LANG",
    "SLOT_ROS",
    "ROS_DOMAIN_ID",
)  # of the caller's environment


class Work(NamedTuple):
    """A figure, its goal, and the row of a benchmark that has it."""

    name: str
    unit: str
    goal: float
    figure: str
    row: Row
    larger: bool = False  # is better


COMMAND, AGE = "odometry to command", "age of a command at the servo"
SEPARATE, COMPOSED, FAST = (
    partial(dict, nodes=nodes, repeat="median")
    for nodes in ("separate", "composed", "composed, 100 Hz")
)
TABLE = {  # figures by benchmark
    "robot": (
        Work(
            "step of the robot",
            "us",
            17.0,
            "us_per_step",
            {"kind": "cost", "nodes": 22},
        ),
    ),
    "learning": (
        Work(
            "steps of 64 environments",
            "1/s",
            1e4,
            "steps_per_s",
            {"level": "standard", "step": 0.0028, "threads": 1},
            larger=True,
        ),
    ),
    "servo": (
        Work(
            "CPU of a cycle of four emulated servos",
            "ms",
            1.2,
            "ms",
            {"kind": "emulated cycle"},
        ),
        Work(
            f"{AGE}, p50",
            "ms",
            5.0,
            "p50_ms",
            {"kind": "age", "nodes": "composed"},
        ),
        Work(
            f"{AGE}, p99",
            "ms",
            10.0,
            "p99_ms",
            {"kind": "age", "nodes": "composed"},
        ),
        Work(
            f"{AGE}, one core kept busy, p99",
            "ms",
            15.0,
            "p99_ms",
            {"kind": "age", "nodes": BUSY},
        ),
    ),
    "graph": (
        Work("CPU of prepare", "ms", 2.5, "prepare_cpu_ms", {"kind": "cycle"}),
        Work("CPU of step", "ms", 0.9, "solve_cpu_ms", {"kind": "cycle"}),
        Work(
            "lockstep with a bag",
            "times",
            4.5,
            "speed",
            {"kind": "lockstep", "nodes": "composed"},
            larger=True,
        ),
        *(
            Work(
                f"{COMMAND}, {nodes['nodes']}, {name}",
                "ms",
                goal,
                f"{name}_ms",
                nodes | {"stage": "end to end"},
            )
            for nodes in (SEPARATE(), COMPOSED())
            for name, goal in (("p50", 4.0), ("p99", 9.0))
        ),
        Work("late ticks", "", 0.0, "deadline_misses", COMPOSED(kind="walk")),
        *(
            Work(
                f"late ticks, composed, {share:.2g} of a core each",
                "%",
                goal,
                "late_percent",
                {"kind": "share", "nodes": "composed", "share": share},
            )
            for share, goal in ((1 / 2, 0.0), (1 / 3, 1.0))
        ),
        Work(
            "CPU of the controller",
            "%",
            25.0,
            "cpu_percent",
            COMPOSED(node="controller"),
        ),
        Work(
            "odometry at 100 Hz: unanswered",
            "",
            0.0,
            "unanswered",
            FAST(kind="walk"),
        ),
        Work(
            "memory of all nodes",
            "MB",
            350.0,
            "pss_mb",
            COMPOSED(node="all nodes"),
        ),
    ),
}


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Run the benchmarks of both revisions in turn."""
    before = (out / "before").resolve()
    if not before.exists():
        progress(f"cloning {REVISION}; its first benchmark sets it up")
        _call("git", "clone", "--quiet", "--no-checkout", ROOT, before)
        _call("git", "-C", before, "checkout", "--quiet", REVISION)
    names = [*TABLE][: 1 if quick else None]
    works = [(name, work) for name in names for work in TABLE[name]]
    roots = {"before": before, "now": ROOT}
    found: dict[tuple[str, str], list[list[Row]]] = {}
    for repeat in range(1 if quick else REPEATS):
        for name in names:
            for when, root in roots.items():
                progress(f"{name}, {when}, repeat {repeat + 1}")
                path = out.resolve() / f"{name}-{when}"
                program = root / "scripts" / "bench"
                _call(program, name, "--quick", "--out", path)
                rows = json.loads((path / f"{name}.json").read_text())["rows"]
                found.setdefault((name, when), []).append(rows)
    table = [
        {"kind": "beside", "work": work.name, "unit": work.unit}
        | {when: median(work, found[name, when]) for when in roots}
        | {"goal": work.goal}
        for name, work in works
    ]
    for row in table:
        known = not math.isnan(row["before"]) and row["before"]
        row["now_over_before"] = row["now"] / row["before"] if known else "-"
        row["before"] = "-" if math.isnan(row["before"]) else row["before"]
    return table, [
        (at_least if work.larger else at_most)(
            work.name, row["now"], work.goal, work.unit
        )
        for (_, work), row in zip(works, table)
    ]


def median(work: Work, repeats: list[list[Row]]) -> float:
    """Median over the repeats of the figure, which one row of each has; NaN: none has it."""
    found = [
        row[work.figure]
        for rows in repeats
        for row in rows
        if work.figure in row and work.row.items() <= row.items()
    ]
    return statistics.median(found) if found else math.nan


def _call(*command: str | Path) -> None:
    """Run a program in an environment of its own; its last line is the error's."""
    kept = {name: os.environ[name] for name in KEPT if name in os.environ}
    done = subprocess.run(
        command, check=False, env=kept, capture_output=True, text=True
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no output"])[-1]
        raise BenchmarkError(f"{Path(command[0]).name} failed: {last}")
