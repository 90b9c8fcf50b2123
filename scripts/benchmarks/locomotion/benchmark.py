"""Locomotion in all directions and under disturbances, with six policies.

Every row of the table is measured in six columns: the gait's angles alone; `place`, a rival without
a model; a learned network, which acts in the gait `walk`
alone; the default, `rollout_mpc`; the paper's problem and map as printed, and as in the authors'
scripts, these in the first case of a row. With --quick there are two columns and fewer rows. The
default must reach the goal of the row, and where the gait alone does not, be better by the row's
`share`, so that a controller without effect fails. Apart from the table stand the margins of the
walk (margins.py). An interrupted benchmark goes on where it ended.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import (
    COURSES,
    Check,
    Outcome,
    Progress,
    Row,
    at_least,
    at_most,
    resumed,
)
from benchmarks.locomotion import ablations, cases, margins, plots
from benchmarks.locomotion.cases import (
    ALONE,
    COLUMNS,
    DEFAULT,
    PAPERS,
    Job,
    WalkMotion,
)
from benchmarks.locomotion.rows import LocomotionRow, ratio, rows

REQUIRES = ("onnx", "onnxruntime")
SEEDS = {**dict.fromkeys(COLUMNS, (1,)), DEFAULT: (1, 2, 3, 4, 5)}
QUICK = {ALONE: (1,), DEFAULT: (1,)}
"""Seeds of the columns that are run."""
Seeds = Mapping[str, Sequence[int]]


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Measure all rows; the plots show some of them, and the walk's margins."""
    seeds, wanted = QUICK if quick else SEEDS, rows(quick)
    walks, parts = margins.jobs(quick), [] if quick else ablations.jobs(wanted)
    jobs = [
        (case, column, seed)
        for row in wanted
        for column in seeds
        for case in in_column(row, column).cases
        for seed in seeds[column]
    ]
    # every job once, the longest first
    every = sorted(
        dict.fromkeys([*jobs, *walks, *parts]),
        key=lambda job: -job[0].duration,
    )
    motions = resumed(
        cases.run_job, every, out / "runs.jsonl", progress, cases.read_motion
    )
    table = measured(wanted, motions, seeds)
    found = [
        margins.row(case, motions[case, column, seed])
        for case, column, seed in walks
    ]
    shown = plots.courses(motions)
    np.savez_compressed(out / COURSES, **shown)
    plots.draw_table(table, out / "table.png")
    plots.draw_velocity(shown, out / "velocity.png")
    plots.draw_top(shown, out / "top.png")
    margins.draw(found, out / "margins.png")
    parted = ablations.measured(wanted, motions) if parts else []
    return [*table, *found, *parted], [
        *checks(wanted, table),
        *margins.checks(found),
        *ablations.checks(parted),
    ]


def in_column(row: LocomotionRow, column: str) -> LocomotionRow:
    """The row with the cases that are run in a column: the paper's run the first."""
    return dataclasses.replace(
        row, cases=row.cases[: 1 if column in PAPERS else None]
    )


def measured(
    wanted: Sequence[LocomotionRow],
    motions: Mapping[Job, WalkMotion],
    seeds: Seeds,
) -> list[dict[str, Any]]:
    """Rows of the table: the worst value over the seeds in every column."""
    table = []
    for row in wanted:
        result: dict[str, Any] = {
            "row": row.name,
            "unit": row.unit,
            "goal": row.goal,
            "better": "larger" if row.larger else "smaller",
        }
        for column, some in seeds.items():
            part = in_column(row, column)
            of_seeds = [
                part.value([motions[case, column, seed] for case in part.cases])
                for seed in some
            ]
            result[column] = min(of_seeds) if row.larger else max(of_seeds)
        table.append(result)
    return table


def checks(
    wanted: Sequence[LocomotionRow], table: Sequence[Row]
) -> list[Check]:
    """Every goal, and the benefit over the gait alone where that misses the goal."""
    found = []
    for row, values in zip(wanted, table):
        reached, alone = values[DEFAULT], values[ALONE]
        compare = at_least if row.larger else at_most
        found.append(compare(row.name, reached, row.goal, row.unit))
        enough = compare(row.name, alone, row.goal).holds
        if row.share is not None and not enough:
            found.append(
                compare(
                    f"{row.name}: over the gait alone",
                    ratio(reached, alone),
                    row.share,
                )
            )
    return found
