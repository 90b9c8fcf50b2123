"""Learned walk: its file, the curve of its learning, its straight walk beside other policies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from slot_core.control.onnx_policy import GAIT, KIND
from slot_core.dynamics.scene import level_changes
from slot_core.gait.reference import mean_velocity
from slot_core.robot import Array
from slot_core.simulation.closed_loop import ClosedLoop
from slot_lab.learning.evolution import Generation
from slot_lab.learning.network import NetworkShape, write_onnx
from slot_lab.learning.task import Task

FRICTION = (0.2, 0.4, 0.6)
SPEED, DURATION, WARM_UP = 0.05, 20.0, 4.0  # m/s, s, s


def export(file: Path | str, task: Task, shape: NetworkShape, parameters: Array) -> None:
    """Write a network as a policy of the graph; raises ValueError for one that sees the servos."""
    if task.servos:
        raise ValueError("servos: a policy of the graph is not given the servos' angles")
    write_onnx(Path(file), shape, parameters, {GAIT: task.gait, KIND: task.actions})


def draw(history: Sequence[Generation], file: Path | str) -> None:
    """Returns over the steps of the environment; the gait alone is what learning begins with."""
    steps = np.array([found.steps for found in history]) / 1e6
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    axes.plot(steps, [found.mean for found in history], ".", label="networks of a generation, mean")
    axes.plot(steps, [found.test for found in history], label="mean network, in 16 other scenes")
    axes.axhline(history[0].test, color="0.5", ls="--", label="gait alone")
    axes.set(xlabel="steps of the environment, millions", ylabel="reward per step")
    axes.legend()
    figure.savefig(file, dpi=150)
    plt.close(figure)


def compare(*policies: str, level: str = "standard") -> str:
    """Table of straight walks at 0.05 m/s on floors of low to high friction."""
    lines = ["friction  policy            speed, mm/s  largest |y|, mm  yaw at the end, deg"]
    for friction in FRICTION:
        for policy in policies:
            speed, aside, turn = straight_walk(policy, friction, level)
            values = f"{1e3 * speed:11.1f}  {1e3 * aside:15.1f}  {np.degrees(turn):19.1f}"
            lines.append(f"{friction:8.1f}  {policy:16s}  {values}")
    return "\n".join(lines)


def straight_walk(policy: str, friction: float, level: str) -> tuple[float, float, float]:
    """Forward speed (m/s), largest deviation to the side (m) and final yaw (rad)."""
    changes = {"scene.floor.friction": [friction] * 4}
    changes |= {f"scene.{name}": value for name, value in level_changes(level).items()}
    loop = ClosedLoop("flat", "walk", np.array([SPEED, 0.0, 0.0]), 1, policy, changes=changes)
    dt = loop.gaits.dt
    track = [
        [*loop.plant.robot.position[:2], loop.plant.robot.rpy[2]]
        for _ in loop.run(round(DURATION / dt))
    ]
    pose, first = np.array(track, dtype=float), round(WARM_UP / dt)
    time: Array = dt * np.arange(len(pose), dtype=float)
    speed = mean_velocity(time[first:], pose[first:])[0]
    return float(speed), float(np.abs(pose[:, 1]).max()), float(np.unwrap(pose[:, 2])[-1])
