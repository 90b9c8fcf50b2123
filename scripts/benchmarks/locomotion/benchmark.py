"""Locomotion in all directions and under disturbances, with six policies.

Every row of the table is measured in six columns: the gait's angles alone; `place`, a rival without
a model; a learned network, which acts in the gait `walk`
alone; the default, `rollout_mpc`; the paper's problem and map as printed, and as in the authors'
scripts, these in the first case of a row. With --quick there are two columns and fewer rows. The
default must reach the goal of the row, and where the gait alone does not, be better by the row's
`share`, so that a controller without effect fails. Apart from the table stand the margins of the
walk (margins.py).
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import COURSES, Check, Progress, at_least, at_most
from benchmarks.harness import Row as Result
from benchmarks.locomotion import cases, transient_rows
from benchmarks.locomotion.cases import (
    ALONE,
    COLUMNS,
    DEFAULT,
    PAPERS,
    Case,
    Job,
    WalkMotion,
)
from benchmarks.locomotion.rows import LocomotionRow, ratio, rows

REQUIRES = ("onnxruntime",)
SEEDS = {column: (1,) if column in PAPERS else (1, 2) for column in COLUMNS}
SEEDS[DEFAULT] = (1, 2, 3, 4, 5)
QUICK = {ALONE: (1,), DEFAULT: (1,)}
"""Seeds of the columns that are run."""
Seeds = Mapping[str, Sequence[int]]
REPORTS = 20  # lines of progress


def run(quick: bool, out: Path, progress: Progress) -> tuple[list[Result], list[Check]]:
    """Measure all rows; the plots show them, and stills of the gaits."""
    from benchmarks.locomotion import ablations, margins, predicted_stride, stills  # noqa: PLC0415
    from benchmarks.locomotion.plots import courses, draw_table, draw_top, draw_velocity  # noqa: PLC0415

    seeds = QUICK if quick else SEEDS
    wanted = [*rows(quick), *transient_rows.rows(quick)]
    walks = margins.jobs(quick)
    parts = [] if quick else ablations.jobs(wanted)
    motions = run_all([*jobs_of(wanted, seeds), *walks, *parts], progress)
    table = measured(wanted, motions, seeds)
    shown = courses(quick, motions)
    np.savez_compressed(out / COURSES, **shown)
    draw_table(table, out / "table.png")
    draw_velocity(shown, out / "velocity.png")
    draw_top(shown, out / "top.png")
    stills.draw(out / "gaits.png")
    predicted_stride.draw(out / "prediction.png")
    found = [
        margins.row(case, motions[case, column, seed]) for case, column, seed in walks
    ]
    margins.draw(found, out / "margins.png")
    results, goals = [*table, *found], [*checks(wanted, table), *margins.checks(found)]
    if not quick:
        parted = ablations.measured(wanted, motions)
        results, goals = [*results, *parted], [*goals, *ablations.checks(parted)]
    return results, goals


def jobs_of(wanted: Sequence[LocomotionRow], seeds: Seeds) -> list[Job]:
    """The cases of every row, in all columns with their seeds."""
    return [
        (case, column, seed)
        for row in wanted
        for column, some in seeds.items()
        for case in cases_of(row, column)
        for seed in some
    ]


def run_all(wanted: Sequence[Job], progress: Progress) -> dict[Job, WalkMotion]:
    """Run every job once, on all cores, the longest first."""
    jobs, found = sorted(dict.fromkeys(wanted), key=lambda job: -job[0].duration), {}
    cases.run_job(jobs[-1])  # the kernels are compiled once, before the workers start
    with multiprocessing.get_context("spawn").Pool(
        len(os.sched_getaffinity(0))
    ) as pool:
        for job, motion in pool.imap_unordered(cases.run_job, jobs):
            found[job] = motion
            if len(found) % max(1, len(jobs) // REPORTS) == 0:
                progress(f"{len(found)} of {len(jobs)} runs")
    return found


def cases_of(row: LocomotionRow, column: str) -> Sequence[Case]:
    """The cases of a row that are run in a column."""
    return row.cases[:1] if column in PAPERS else row.cases


def measured(
    wanted: Sequence[LocomotionRow], motions: Mapping[Job, WalkMotion], seeds: Seeds
) -> list[dict[str, Any]]:
    """Rows of the table: the worst value over the seeds in every column."""
    table = []
    for row in wanted:
        result: dict[str, Any] = {"row": row.name, "unit": row.unit, "goal": row.goal}
        result["better"] = "larger" if row.larger else "smaller"
        for column, some in seeds.items():
            part = dataclasses.replace(row, cases=cases_of(row, column))
            of_seeds = [
                part.value([motions[case, column, seed] for case in part.cases])
                for seed in some
            ]
            result[column] = min(of_seeds) if row.larger else max(of_seeds)
        table.append(result)
    return table


def checks(wanted: Sequence[LocomotionRow], table: Sequence[Result]) -> list[Check]:
    """Every goal, and the benefit over the gait alone where that misses the goal."""
    return [
        check for row, values in zip(wanted, table) for check in _checks(row, values)
    ]


def _checks(row: LocomotionRow, values: Result) -> Iterator[Check]:
    reached, alone = values[DEFAULT], values[ALONE]
    compare = at_least if row.larger else at_most
    yield compare(row.name, reached, row.goal, row.unit)
    enough = compare(row.name, alone, row.goal, row.unit).holds
    if row.share is not None and not enough:
        yield compare(
            f"{row.name}: over the gait alone", ratio(reached, alone), row.share
        )
