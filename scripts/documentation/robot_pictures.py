"""Pictures of the simulated robot: every gait in stills, and a predicted stride."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from slot_core.arrays import Array
from slot_core.control.policy import TendonPlan
from slot_core.drawing import palette
from slot_core.drawing.drawing import FORCE_SCALE
from slot_core.gait.gait import read_gaits
from slot_core.robot import LEGS, read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_lab.report.robot_drawing import (
    Snapshot,
    Viewpoint,
    draw_robot,
    snapshot,
)

DT = read_gaits().dt  # s, between ticks
SETTLED = 3.0  # s, before the first still
FIVE = math.radians(5.0)
CAMERA = Viewpoint()
FRONT = Viewpoint(azimuth=0.0, elevation=math.radians(6.0))
SIDE = Viewpoint(azimuth=-math.pi / 2, elevation=math.radians(6.0))
FOOT_NAMES = ("front left", "front right", "rear left", "rear right")
SHARES = np.arange(5) / 5  # of a stride, the stills
MM = 1e3


class Still(NamedTuple):
    """A gait, its command and how it is shown."""

    name: str
    gait: str = "walk"
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pose: tuple[float, float, float] | None = None
    camera: Viewpoint = CAMERA


POSTURES = (
    Still("lie, from the right", "lie", camera=SIDE),
    Still("sit, from the right", "sit", camera=SIDE),
    Still("stand, from the right", "stand", camera=SIDE),
    Still(
        "roll of 5 deg: right side down,\nfrom the front",
        "stand",
        pose=(0.04, FIVE, 0),
        camera=FRONT,
    ),
    Still(
        "pitch of 5 deg: nose down,\nfrom the right",
        "stand",
        pose=(0.04, 0, FIVE),
        camera=SIDE,
    ),
)
STRIDES = (
    Still("walk forward\n0.05 m/s", velocity=(0.05, 0.0, 0.0)),
    Still("walk to the left\n0.05 m/s", velocity=(0.0, 0.05, 0.0)),
    Still("turn in place\n0.15 rad/s", velocity=(0.0, 0.0, 0.15)),
    Still("fast_walk\n0.08 m/s", "fast_walk", (0.08, 0.0, 0.0)),
    Still("crawl\n0.02 m/s", "crawl", (0.02, 0.0, 0.0)),
    Still("paper_walk\n0.08 m/s", "paper_walk", (0.08, 0.0, 0.0)),
    Still("paper_crawl\n0.02 m/s", "paper_crawl", (0.02, 0.0, 0.0)),
)
FIRST, LAST = round(6.0 / DT), round(9.0 / DT)  # ticks of the predicted walk
EVERY = 15  # ticks between two predictions in a plot


def draw_gaits(path: Path) -> None:
    """Write a PNG: the postures, then a gait a row at equal shares of its stride."""
    figure = Figure(figsize=(11.0, 10.4), layout="constrained")
    above, below = figure.subfigures(
        2, 1, height_ratios=(1.6, len(STRIDES) + 0.9)
    )
    above.suptitle("Postures; dashed: 40 mm above the floor", fontsize=11)
    for ax, still in zip(above.subplots(1, len(POSTURES)), POSTURES):
        [pose] = _poses(still, [0.0])
        _draw_still(ax, pose, still.camera)
        ax.set_ylim(-0.03, 0.11)
        ax.axhline(0.04, color=palette.SECONDARY, lw=0.8, ls="--", zorder=9)
        height = f"{still.name}\ncentre {MM * pose.position[2]:.0f} mm high"
        ax.text(
            0.5, -0.05, height, transform=ax.transAxes, ha="center", va="top"
        )
    below.suptitle(
        "Gaits over one stride: its share that has passed", fontsize=11
    )
    widths = (0.62, *np.ones(len(SHARES)))
    grid = below.subplots(len(STRIDES), len(widths), width_ratios=widths)
    for row, still in zip(grid, STRIDES):
        row[0].set_axis_off()
        row[0].text(0.0, 0.45, still.name, va="center", fontsize=10)
        for ax, pose in zip(
            row[1:],
            _poses(still, SHARES * read_gaits().strides[still.gait].period),
        ):
            _draw_still(ax, pose, CAMERA)
    for ax, share in zip(grid[0, 1:], SHARES):
        ax.set_title(f"{100 * share:.0f} %", fontsize=10)
    handles: list[Any] = [
        Line2D(
            [], [], color=palette.LEG_COLOURS[leg], lw=5, label=f"{name} leg"
        )
        for leg, name in zip(LEGS, FOOT_NAMES)
    ]
    force = f"force of the floor, {MM * FORCE_SCALE:.0f} mm of arrow for 1 N; none: foot in the air"
    handles.append(
        Line2D([], [], color=palette.INK, marker="^", ls="none", label=force)
    )
    figure.legend(
        handles=handles, loc="outside lower center", ncols=5, frameon=False
    )
    figure.savefig(path, dpi=110)


def _draw_still(ax: Axes, pose: Snapshot, camera: Viewpoint) -> None:
    draw_robot(ax, pose, read_robot(), camera)
    for shape in ax.collections:
        shape.set_clip_on(False)  # a leg may stand above the ground's plot
    for text in ax.texts:  # arrows too, which have no words
        text.set_visible(not text.get_text())  # there is no room for the scale


def _poses(still: Still, times: Sequence[float]) -> list[Snapshot]:
    """The robot at `times` (s) after it has settled in its gait, to the nearest tick."""
    loop = ClosedLoop("flat", still.gait, np.array(still.velocity), 1)
    if still.pose is not None:
        loop.controller.scheduler.set_pose(np.array(still.pose))
    wanted = [round((SETTLED + time) / DT) for time in times]
    ticks = enumerate(loop.run(max(wanted) + 1))
    found = {k: snapshot(loop.plant.robot) for k, _ in ticks if k in wanted}
    return [found[k] for k in wanted]


def draw_prediction(path: Path) -> None:
    """Write a PNG: the robot with the predicted ways, and predictions beside the true motion."""
    loop = ClosedLoop("payload", "walk", np.array((0.05, 0.0, 0.0)), 1)
    sim, plans, true = loop.plant.robot, list[TendonPlan](), []
    for k, tick in enumerate(loop.run(LAST + 1)):
        true.append(np.concatenate([sim.rpy, sim.position]))
        plans.append(tick.plan)
        if k == FIRST:
            pose = snapshot(sim)
    figure = Figure(figsize=(8.0, 7.2), layout="constrained")
    above, below = figure.subfigures(2, 1)
    ax = above.subplots()
    draw_robot(ax, pose, read_robot(), CAMERA)
    centre, plan = np.array([*pose.position[:2], 0.0]), plans[FIRST]
    ways = [(plan.pose[:, 3:], palette.INK)]
    ways += zip(np.moveaxis(plan.foot, 1, 0), palette.LEG_COLOURS.values())
    for way, colour in ways:
        ax.plot(*CAMERA.project(way - centre).T, color=colour, lw=2.0, zorder=6)
    ax.set_title(
        "the next stride, as predicted: ways of torso and feet",
        fontsize=10,
        loc="left",
    )
    motion, axes = np.array(true), below.subplots(2, 1, sharex=True)
    for ax, column, name in zip(axes, (3, 5), ("x, mm", "height, mm")):
        _draw_beside(ax, MM * motion[:, column], plans, column)
        ax.set_ylabel(name)
    axes[1].set_xlabel("time, s")
    axes[0].legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=130)


def _draw_beside(
    ax: Axes, true: Array, plans: Sequence[TendonPlan], column: int
) -> None:
    """The true course of a column of the pose, mm, and predictions of it from several ticks on."""
    time, shown = DT * np.arange(len(true)), slice(FIRST, LAST)
    ax.plot(time[shown], true[shown], color=palette.TRUE, lw=2.5, label="true")
    for k in range(FIRST, LAST, EVERY):
        ahead = [true[k], *(MM * plans[k].pose[:, column])]
        ax.plot(
            time[k] + DT * np.arange(len(ahead)),
            ahead,
            "--",
            color=palette.INK,
            lw=1.1,
            label="predicted from the dot on" if k == FIRST else None,
        )
        ax.plot(time[k], true[k], "o", color=palette.INK, ms=3.5)
    ax.grid(color=palette.PALE, lw=0.4)
