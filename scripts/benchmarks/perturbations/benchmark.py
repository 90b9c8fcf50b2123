"""Stability of the MPC: the paper's seven perturbations beside its table.

Two studies: the published problem on its own linear model (`slot_paper.perturbations`), and the
default policy on the Cosserat robot, which stands (simulated.py). Neither seed nor clipping of the
paper's noise is published: here seed 1, clipped at 1 (SI). The published problem starts with every
state zero but the perturbation; at the reference its cost would be 0. The robot has other weights:
its settling and feasibility compare with the paper, its cost does not.
"""

import dataclasses
from pathlib import Path

import numpy as np

from benchmarks.harness import COURSES, Check, Progress, Row, at_most
from benchmarks.perturbations.plots import draw_courses
from benchmarks.perturbations.simulated import run_robot
from slot_core.robot import read_robot
from slot_paper.perturbations import CASES, DURATION, TABLE, run_published
from slot_paper.problem import read_paper_mpc

QUICK_DURATION = 6.0  # s, of the robot
REPRODUCED = ("Baseline", "Roll", "Height", "Velocity", "Combined")
MOST_DEVIATION = 0.5  # % of the paper's maximum cost
LATEST = 2.0  # s, settling time


def run(quick: bool, out: Path, progress: Progress) -> tuple[list[Row], list[Check]]:
    """Run the studies; `perturbations.png` shows them. The published one lasts as in the paper."""
    robot, settings = read_robot(), read_paper_mpc("paper_code")
    rows, checks, courses = [], [], {}
    for case in CASES:
        progress(f"case {case}")
        published = run_published(robot, settings, case)
        walked, reached = run_robot(case, QUICK_DURATION if quick else DURATION)
        for study, found in (("published", published), ("robot", walked)):
            rows.append(
                {"kind": "case", "study": study, "case": case, **found.metrics()}
            )
            for name, value in dataclasses.asdict(found).items():
                courses[f"{study}/{case}/{name}"] = value
        rows[-1] |= reached
        most, settled = published.cost.max(), rows[-1]["settling_s"]
        if case in REPRODUCED:
            off = 100 * abs(most / TABLE[case][0] - 1)
            name = f"published, {case}: maximum cost"
            checks.append(at_most(name, off, MOST_DEVIATION, "% off the paper"))
        name = f"robot, {case}: "
        checks.append(at_most(f"{name}infeasible steps", walked.infeasible, 0))
        checks.append(at_most(f"{name}settled", settled, LATEST, "s"))
    np.savez_compressed(out / COURSES, **courses)
    draw_courses(courses, out / "perturbations.png")
    return rows, checks
