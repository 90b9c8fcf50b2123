"""The default policy on an engine that nothing was tuned on: rows of locomotion with the robot in MuJoCo.

The first case of each row runs with the robot on Cosserat rods and with the robot on chains of hinges
in MuJoCo, where the controller is the same: estimator, gait, policy and leg table know the first
alone. A value is the worst of the seeds. With --quick there is one row with one seed, without the
gait alone.
"""

import dataclasses
from pathlib import Path

from benchmarks.harness import Outcome, Progress, at_most, resumed
from benchmarks.locomotion import cases
from benchmarks.locomotion.cases import ALONE, DEFAULT, Job, WalkMotion
from benchmarks.locomotion.rows import rows
from benchmarks.robot.mujoco_robot import MujocoRobot
from slot_core.simulation.plant import RobotSimulator

ROWS = (
    "velocity .02 to .06: to a tenth",
    "lateral error, split friction",
    "heading, split friction",
    "circle of 1 m radius, RMS",
    "standing, heights .030 to .060: height",
)
NODES = 14  # of a leg in MuJoCo: the default number takes thrice as long
SEEDS = (1, 2, 3)
# columns of the results: policy and engine
COLUMNS = {
    "rods": (DEFAULT, "rods"),
    "mujoco": (DEFAULT, "mujoco"),
    "mujoco, gait alone": (ALONE, "mujoco"),
}


class MujocoSimulator(RobotSimulator):
    """Servos and sensors of the robot in MuJoCo."""

    make_robot = staticmethod(MujocoRobot)


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Measure all rows in both engines, and the gait alone in MuJoCo; goals are those of locomotion."""
    names, seeds = (ROWS[:1], SEEDS[:1]) if quick else (ROWS, SEEDS)
    columns = [*COLUMNS][: 2 if quick else None]
    wanted = [
        dataclasses.replace(row, cases=row.cases[:1])
        for row in rows(quick=False)
        if row.name in names
    ]
    jobs = [
        (row.cases[0], column, seed)
        for row in wanted
        for column in columns
        for seed in seeds
    ]
    motions = resumed(
        run_job,
        list(dict.fromkeys(jobs)),
        out / "runs.jsonl",
        progress,
        cases.read_motion,
    )
    found = [
        {"row": row.name, "unit": row.unit, "goal": row.goal}
        | {
            column: max(
                row.value([motions[row.cases[0], column, seed]])
                for seed in seeds
            )
            for column in columns
        }
        for row in wanted
    ]
    return found, [
        at_most(f"in MuJoCo, {row.name}", values["mujoco"], row.goal, row.unit)
        for row, values in zip(wanted, found, strict=True)
    ]


def run_job(job: Job) -> tuple[Job, WalkMotion]:
    """The job and its motion."""
    case, column, seed = job
    policy, engine = COLUMNS[column]
    if engine == "rods":
        return job, cases.run_case(case, policy, seed)
    changes = (*case.changes, ("scene.solver.nodes", NODES))
    case = dataclasses.replace(case, changes=changes)
    return job, cases.run_case(case, policy, seed, MujocoSimulator)
