"""Picture of the prediction: what the policy expects of the next stride, and what comes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.locomotion.cases import DT
from slot_core.arrays import Array
from slot_core.control.policy import TendonPlan
from slot_core.drawing import palette
from slot_core.drawing.shapes import bent_legs
from slot_core.robot import LEGS, read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_lab.report.robot_drawing import Snapshot, Viewpoint, draw_robot

FIRST, LAST = round(6.0 / DT), round(9.0 / DT)  # ticks of the walk that are shown
CAMERA = Viewpoint()
EVERY = 15  # ticks between two predictions in a plot
AHEAD = (0.05, 0.0, 0.0)  # m/s
MM = 1e3


def draw(path: Path) -> None:
    """Write a PNG: the robot with the predicted ways, and predictions beside the true motion."""
    loop = ClosedLoop("payload", "walk", np.array(AHEAD), 1)
    sim, robot, plans, true = loop.plant.robot, read_robot(), [], []
    for k, tick in enumerate(loop.run(LAST + 1)):
        true.append(np.concatenate([sim.rpy, sim.position]))
        plans.append(tick.plan)
        if k == FIRST:
            legs = bent_legs(sim.nodes, sim.directors, sim.quaternion, robot)
            pose = Snapshot(
                k * DT, sim.position, sim.quaternion, legs, sim.ground_force
            )
    figure = Figure(figsize=(8.0, 7.2), layout="constrained")
    above, below = figure.subfigures(2, 1)
    ax = above.subplots()
    draw_robot(ax, pose, robot, CAMERA)
    centre = np.array([*pose.position[:2], 0.0])
    draw_ways(ax, plans[FIRST].pose[:, 3:] - centre, plans[FIRST].foot - centre)
    ax.set_title(
        "the next stride, as predicted: ways of torso and feet", fontsize=10, loc="left"
    )
    motion, axes = np.array(true), below.subplots(2, 1, sharex=True)
    for ax, column, name in zip(axes, (3, 5), ("x, mm", "height, mm")):
        draw_beside(ax, MM * motion[:, column], plans, column)
        ax.set_ylabel(name)
    axes[1].set_xlabel("time, s")
    axes[0].legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=130)


def draw_ways(ax: Axes, torso: Array, feet: Array) -> None:
    """Predicted ways (n, 3) of the torso and (n, 4, 3) of the feet, m from the plot's centre."""
    ax.plot(*CAMERA.project(torso).T, color=palette.INK, lw=2.0, zorder=6)
    for leg, name in enumerate(LEGS):
        colour = palette.LEG_COLOURS[name]
        ax.plot(*CAMERA.project(feet[:, leg]).T, color=colour, lw=2.0, zorder=6)


def draw_beside(
    ax: Axes, true: Array, plans: Sequence[TendonPlan], column: int
) -> None:
    """The true course of a column of the pose, mm, and predictions of it from several ticks on."""
    time = DT * np.arange(len(true))
    ax.plot(
        time[FIRST:LAST], true[FIRST:LAST], color=palette.TRUE, lw=2.5, label="true"
    )
    for k in range(FIRST, LAST, EVERY):
        pose = MM * plans[k].pose[:, column]
        label = "predicted from the dot on" if k == FIRST else "_"
        ax.plot(
            time[k] + DT * np.arange(len(pose) + 1),
            [true[k], *pose],
            "--",
            color=palette.INK,
            lw=1.1,
            label=label,
        )
        ax.plot(time[k], true[k], "o", color=palette.INK, ms=3.5)
    ax.grid(color=palette.PALE, lw=0.4)
