"""Learned walk: its file, the curve of its learning, its straight walk beside other policies."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from slot_core.arrays import Array
from slot_core.control.onnx_policy import GAIT, KIND
from slot_core.drawing import palette
from slot_core.dynamics.scene import level_changes
from slot_core.gait.gait import STAND, mean_velocity
from slot_core.simulation.closed_loop import ClosedLoop
from slot_lab.learning.evolution import Generation
from slot_lab.learning.network import NetworkShape, write_onnx
from slot_lab.learning.task import Task

FRICTION = (0.2, 0.4, 0.6)
SPEED, STANDING, DURATION, WARM_UP = 0.05, 1.0, 20.0, 4.0  # m/s, s, s, s
SEEDS = (1, 2, 3)  # of the sensors' noise


def export(
    file: Path | str, task: Task, shape: NetworkShape, parameters: Array
) -> None:
    """Write a network as a policy of the graph; raises ValueError if it sees the servos."""
    if task.servos:
        raise ValueError(
            "servos: a policy of the graph is not given the servos' angles"
        )
    write_onnx(
        Path(file), shape, parameters, {GAIT: task.gait, KIND: task.actions}
    )


def draw(history: Sequence[Generation], file: Path | str) -> None:
    """Returns over the steps of the environment; the gait alone is what learning begins with."""
    steps = np.array([found.steps for found in history]) / 1e6
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    ax = figure.subplots()
    test = [found.test for found in history]
    ax.plot(
        steps,
        test,
        "o-",
        color=palette.TRUE,
        ms=4,
        label="learned, in 16 other scenes",
    )
    ax.plot(
        steps,
        [found.mean for found in history],
        "x",
        color=palette.SECONDARY,
        label="tried, mean of a generation",
    )
    ax.axhline(test[0], color=palette.INK, lw=1, ls="--", label="gait alone")
    ax.grid(visible=True, color=palette.PALE, lw=0.5)
    ax.set(
        xlabel="steps of the environment, millions", ylabel="reward per step"
    )
    ax.legend(frameon=False, loc="center right")
    figure.savefig(file, dpi=130)


def compare(*policies: str, level: str = "standard") -> str:
    """Table of straight walks on floors of low to high friction: the worst over SEEDS."""
    lines = [
        "friction  policy            error of speed, mm/s  largest |y|, mm  mean yaw, deg"
    ]
    for friction in FRICTION:
        for policy in policies:
            speed, aside, yaw = np.abs(
                [straight_walk(policy, friction, level, seed) for seed in SEEDS]
            ).max(axis=0)
            lines.append(
                f"{friction:8.1f}  {policy:16s}  {1e3 * speed:20.1f}"
                f"  {1e3 * aside:15.1f}  {np.degrees(yaw):13.2f}"
            )
    return "\n".join(lines)


def straight_walk(policy: str, friction: float, level: str, seed: int) -> Array:
    """Walk for DURATION at SPEED, after STANDING: distance (3,) from the commanded walk.

    Error of the mean speed after WARM_UP, m/s; largest |y|, m; mean yaw after WARM_UP, rad.

    The reference that a policy follows begins with the error of one estimate: the first's is
    1.9 mrad and 0.8 mm (RMS), which leads 3 mm aside in 1 m; after STANDING 0.5 mrad and 0.3 mm.
    """
    changes = {"scene.floor.friction": [friction] * 4} | {
        f"scene.{name}": value for name, value in level_changes(level).items()
    }
    loop = ClosedLoop("flat", STAND, np.zeros(3), seed, policy, changes=changes)
    dt, robot, track = loop.gaits.dt, loop.plant.robot, []
    begin, first = round(STANDING / dt), round(WARM_UP / dt)
    for tick, _ in enumerate(loop.run(begin + round(DURATION / dt)), 1):
        track.append([*robot.position[:2], robot.rpy[2]])
        if tick == begin:
            loop.controller.scheduler.request(
                "walk", np.array([SPEED, 0.0, 0.0])
            )
    pose = np.array(track[begin:], dtype=float) - track[begin]
    time: Array = dt * np.arange(len(pose), dtype=float)
    return np.array(
        [
            mean_velocity(time[first:], pose[first:])[0] - SPEED,
            np.abs(pose[:, 1]).max(),
            np.unwrap(pose[:, 2])[first:].mean(),
        ]
    )
