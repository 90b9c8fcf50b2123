"""Stability of the MPC: the paper's seven perturbations beside its table.

Two studies: the published problem on its own linear model, and the default policy on the Cosserat
robot. Details are in published.py and simulated.py.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import (
    COURSES,
    Check,
    Progress,
    Row,
    at_most,
)
from benchmarks.perturbations.cases import (
    CASES,
    DURATION,
    NOISE,
    TABLE,
    PerturbedRun,
    courses_of,
    metrics,
)
from benchmarks.perturbations.plots import draw_responses, table_lines
from benchmarks.perturbations.published import run_published
from benchmarks.perturbations.simulated import run_robot
from slot_core.mpc.settings import read_paper_mpc
from slot_core.robot import read_robot

QUICK_DURATION = 6.0  # s, of the robot
NOISE_SEED = 1
PAPER = ("max_cost", "mean_cost", "final_cost", "settling_s")  # figures of the table
REPRODUCED = ("Baseline", "Roll", "Height", "Velocity", "Combined")
MOST_DEVIATION = 0.5  # % of the paper's maximum cost
LATEST = 2.0  # s, settling time
NOTES = (
    "Noise: neither seed nor clipping are published; here seed 1, clipped at 1 (SI)",
    "Pitch: ill-posed; R leaves the normal forces nearly free, the raised steps make a cost of it",
    "published: problem and model of the policy paper_code",
    "mean cost and settling time: their intervals are not published in the paper",
    "published starts with every state zero but the perturbation; at the reference the cost would be 0",
    "robot: other weights: settling and feasibility compare with the paper, the cost does not",
    "robot stands still: the sway of a walk is larger than the perturbations",
    "robot, Height: the torso's underside reaches the floor at 17 mm, so 10 mm is not possible",
)
Runs = dict[str, PerturbedRun]  # by case


def run(quick: bool, out: Path, progress: Progress) -> tuple[list[Row], list[Check]]:
    """Run the studies; `perturbations.png` shows them."""
    runs, rows = cases(QUICK_DURATION if quick else DURATION, progress)
    rows += [{"kind": "note", "note": note} for note in NOTES]
    np.savez_compressed(out / COURSES, **courses_of(runs))
    draw_responses(runs, out / "perturbations.png")
    for line in table_lines(rows):
        progress(line)
    return rows, checks(rows)


def cases(
    duration: float, progress: Progress
) -> tuple[dict[str, Runs], list[dict[str, Any]]]:
    """Run every case of both studies; the published one always lasts as long as in the paper."""
    robot, published = read_robot(), read_paper_mpc("paper_code")
    runs: dict[str, Runs] = {"published": {}, "robot": {}}
    rows = []
    for name, change in CASES.items():
        progress(f"case {name}")
        noisy = name == "Noise"
        noise = np.random.default_rng(NOISE_SEED) if noisy else None
        runs["published"][name] = run_published(
            robot, published, change, DURATION, noise
        )
        runs["robot"][name], reached = run_robot(
            change, duration, NOISE if noisy else 0.0
        )
        for study, by_case in runs.items():
            row = {"kind": "case", "study": study, "case": name} | metrics(
                by_case[name]
            )
            row |= {f"paper_{key}": value for key, value in zip(PAPER, TABLE[name])}
            rows.append(row | (reached if study == "robot" else {}))
    return runs, rows


def checks(rows: Iterable[Row]) -> list[Check]:
    """The published problem against the paper; the robot feasible and settled."""
    out = []
    for row in rows:
        if row["kind"] != "case":
            continue
        name = f"{row['study']}, {row['case']}"
        if row["study"] == "published":
            if row["case"] in REPRODUCED:
                off = 100 * abs(row["max_cost"] / row["paper_max_cost"] - 1)
                out.append(
                    at_most(
                        f"{name}: maximum cost", off, MOST_DEVIATION, "% off the paper"
                    )
                )
        else:
            out.append(at_most(f"{name}: infeasible steps", row["infeasible"], 0))
            out.append(at_most(f"{name}: settled", row["settling_s"], LATEST, "s"))
    return out
