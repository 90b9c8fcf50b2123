"""Other legs of a lab: scripts/tune leg, and the walk at the cruise speed that it finds.

A directory of the results gets a robot.yaml with the leg, and `scripts/tune leg` makes leg map, walk
and crawl there. The default policy then walks with that configuration, on its own leg: the values
are the worst of the seeds. The goal of ten minutes is for the CPU time over the cores, which other
work on the machine changes least; the wall time stands beside it. With --quick there is the first
leg with one seed, and the search ends after a generation, to no good gait.
"""

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import yaml
from matplotlib.figure import Figure

from benchmarks.harness import (
    ROOT,
    Attempts,
    BenchmarkError,
    Check,
    Outcome,
    Progress,
    Row,
    at_most,
)
from benchmarks.locomotion.cases import DEFAULT, Case, run_case
from benchmarks.locomotion.rows import DEG, MM, WARM_UP
from slot_core import config
from slot_core.drawing import palette
from slot_core.gait.gait import read_gaits

LEGS: dict[str, dict[str, Any]] = {
    "150 x 25 mm, tip 4 mm": {
        "reach": 0.15,
        "width": 0.025,
        "contact_width": 0.025,
        "thickness_tip": 0.004,
    },
    "220 mm, 15 to 5 mm": {
        "reach": 0.22,
        "thickness_clamp": 0.015,
        "thickness_tip": 0.005,
    },
    "azimuth 60 deg": {"azimuth_deg": [60.0, -60.0, 120.0, -120.0]},
}
"""Values of `leg` in robot.yaml; the shipped leg: 190 x 20 mm, 13.5 to 3.5 mm, azimuth 45 deg."""
SEEDS = (1, 2, 3)
DURATION = 24.0  # s, of a walk
TUNED, MISSED = 600.0, 10.0  # s; % of the cruise speed
CORES = len(os.sched_getaffinity(0))
QUICK = ("--gaits", "walk", "--evaluations", "12")


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Tune and walk each leg."""
    attempts = Attempts()
    for name in [*LEGS][: 1 if quick else None]:
        progress(name)
        row = attempts.run(name, measured, name, quick, out.absolute())
        if row is not None:
            attempts.rows.append(row)
            attempts.checks += checks(row)
    draw([r for r in attempts.rows if r["kind"] == "leg"], out / "legs.png")
    return attempts.rows, attempts.checks


def measured(name: str, quick: bool, out: Path) -> Row:
    """Times of the tuning, and the walk with what it made; raises BenchmarkError."""
    directory = out / f"leg_{[*LEGS].index(name)}"
    shutil.rmtree(directory, ignore_errors=True)
    directory.mkdir()
    robot = config.load("robot")
    robot["leg"] |= LEGS[name]
    (directory / "robot.yaml").write_text(yaml.safe_dump(robot))
    words, begin = [ROOT / "scripts" / "tune", "leg", directory], os.times()
    if subprocess.run(
        [*words, *(QUICK if quick else ())], cwd=directory, check=False
    ).returncode:
        raise BenchmarkError("scripts/tune leg has failed")
    used = np.subtract(os.times(), begin)
    with mock.patch.dict(os.environ, SLOT_CONFIG=str(directory)):
        cruise = read_gaits().strides["walk"].cruise
        case = Case(DURATION, velocity=(cruise, 0.0, 0.0))
        found = [
            run_case(case, DEFAULT, seed).after(WARM_UP)
            for seed in SEEDS[: 1 if quick else None]
        ]
    speed = np.array([motion.forward_speed for motion in found])
    return {
        "kind": "leg",
        "leg": name,
        "wall_s": used[4],
        "cpu_s_per_core": (used[2] + used[3]) / CORES,
        "cruise_mm_s": MM * cruise,
        "reached_mm_s": MM * speed.min(),
        "missed_percent": 100 * np.abs(speed / cruise - 1).max(),
        "tilt_deg": DEG * max(motion.tilt.max() for motion in found),
        "height_mm": MM * min(motion.position[:, 2].mean() for motion in found),
        "falls": sum(motion.fallen for motion in found),
    }


def checks(row: Row) -> list[Check]:
    """Goals of a leg: ten minutes on all cores, its cruise speed within a tenth, no fall."""
    name = row["leg"]
    return [
        at_most(f"{name}: tuned, CPU time", row["cpu_s_per_core"], TUNED, "s"),
        at_most(f"{name}: cruise speed", row["missed_percent"], MISSED, "%"),
        at_most(f"{name}: falls", row["falls"], 0),
    ]


def draw(rows: Sequence[Row], path: Path) -> None:
    """Write the plot: time of the tuning, and the speed beside the cruise speed, of each leg."""
    figure = Figure(figsize=(8.5, 1.4 + 0.5 * len(rows)), layout="constrained")
    names = [row["leg"] for row in rows]
    left, right = figure.subplots(1, 2, sharey=True)
    for key, width, colour in (
        ("wall_s", 0.5, palette.PALE),
        ("cpu_s_per_core", 0.25, palette.TRUE),
    ):
        left.barh(names, [row[key] for row in rows], width, color=colour)
    left.axvline(TUNED, color=palette.INK, lw=0.8)
    left.set(xlabel="tuning, s: wall, pale, and CPU per core")
    left.invert_yaxis()
    for key, mark, size in (("reached", "o", 9), ("cruise", "k|", 20)):
        speeds = [row[f"{key}_mm_s"] for row in rows]
        right.plot(speeds, names, mark, ms=size, label=key)
    right.set(xlabel="speed, mm/s", xlim=(0, 60))
    right.legend(frameon=False, fontsize=9)
    figure.savefig(path, dpi=130)
