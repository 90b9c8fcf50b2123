"""The plots of the locomotion benchmark: table, velocities in all directions, top views."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.locomotion.cases import COLUMNS, Case, WalkMotion
from benchmarks.locomotion.rows import CAUGHT_UP, SIDE
from slot_core.drawing import palette

SHADES = ("#E69F00", "#CC79A7", "#56B4E9", "#D55E00", palette.TRUE, "#BBBBBB", "#888888")
COLOURS = dict(zip(COLUMNS, SHADES))
SHOWN = (0.05, 100.0)  # in goals
PARTS = 2  # columns of rows
# marker, its size and colour; the default last, over the others
MARKS = {
    "gait alone": ("|", 9, palette.INK),
    "stride feedback": ("x", 5, palette.SECONDARY),
    "place": ("o", 5, "#009E73"),
    "learned": ("^", 5, "#CC79A7"),
    "default": ("D", 6, palette.TRUE),
}
Motions = Mapping[tuple[Case, str, int], WalkMotion]


def draw_table(table: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Every row as a multiple of its goal, the default beside its rivals; a fall is at the right.

    The policies of the paper are left out, since they do not walk.
    """
    half = math.ceil(len(table) / PARTS)
    figure = Figure(figsize=(13.0, 1.2 + 0.22 * half), layout="constrained")
    for part, ax in enumerate(figure.subplots(1, PARTS)):
        rows = table[part * half : (part + 1) * half]
        ax.axvspan(SHOWN[0], 1.0, color=palette.SHADE, zorder=0)
        for column, (marker, size, colour) in MARKS.items():
            if column in table[0]:
                ratio = [np.clip(_in_goals(values, column), *SHOWN) for values in rows]
                style = {"color": colour, "fillstyle": "none" if marker == "o" else "full"}
                ax.plot(ratio, np.arange(len(rows)), marker, ms=size, label=column, **style)
        names = [f"{values['row']}, {values['unit']}".rstrip(", ") for values in rows]
        ax.set_yticks(np.arange(len(rows)), names, fontsize=8)
        ax.tick_params(axis="y", length=0)
        ax.set(xscale="log", xlim=SHOWN, ylim=(half - 0.5, -0.5), xlabel="error over goal")
        ax.grid(color=palette.PALE, lw=0.4)
        ax.set_axisbelow(True)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.suptitle("Errors of the policies over the goal of each row; shaded: holds", fontsize=11)
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(path, dpi=110)


def draw_directions(
    cases: Sequence[Case], motions: Motions, seeds: Sequence[int], path: Path
) -> None:
    """Commanded (circles) and achieved mean velocity (points) in all directions that were run."""
    figure = Figure(figsize=(5.5, 5.5), layout="constrained")
    ax = figure.subplots()
    wanted = np.array([case.velocity[:2] for case in cases])
    ax.plot(*wanted.T, "o", color=palette.INK, fillstyle="none", markersize=12, label="commanded")
    for column, colour in COLOURS.items():
        for case, (v_x, v_y) in zip(cases, wanted):
            for seed in seeds:
                if (case, column, seed) not in motions:
                    continue
                reached = motions[case, column, seed].after(CAUGHT_UP).velocity[:2]
                ax.plot([v_x, reached[0]], [v_y, reached[1]], color=colour, linewidth=0.8)
                ax.plot(*reached, ".", color=colour, markersize=8)
        ax.plot([], [], ".-", color=colour, label=column)
    ax.set(xlabel="v_x, m/s", ylabel="v_y, m/s", aspect="equal")
    ax.grid(alpha=0.3)
    ax.legend(frameon=False, fontsize=8, loc="upper right")
    figure.savefig(path, dpi=150)


def draw_top(
    square: Case, slanted: Case, motions: Motions, seeds: Sequence[int], path: Path
) -> None:
    """The square and the 60 deg path from above."""
    figure = Figure(figsize=(11.0, 5.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    corners = np.array([[0, 0], [SIDE, 0], [SIDE, SIDE], [0, SIDE], [0, 0]])
    left.plot(*corners.T, color=palette.INK, linewidth=1.0, linestyle="--", label="commanded")
    right.plot(*np.array(slanted.path).T, color=palette.INK, linewidth=1.0, linestyle="--")
    for ax, case, title in ((left, square, "square of .6 m"), (right, slanted, "60 deg path")):
        for column in COLOURS:
            for seed in seeds:
                if (case, column, seed) in motions:
                    label = column if seed == seeds[0] else "_"
                    _track(ax, motions[case, column, seed], label, column)
        ax.set(xlabel="x, m", ylabel="y, m", aspect="equal", title=title)
        ax.grid(alpha=0.3)
    left.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=150)


def _track(ax: Axes, motion: WalkMotion, label: str, column: str) -> None:
    """The torso's track, with its heading every two seconds."""
    x, y = motion.position[:, :2].T
    ax.plot(x, y, color=COLOURS[column], linewidth=1.2, label=label)
    every = slice(None, None, round(2.0 / (motion.time[1] - motion.time[0])))
    yaw = motion.rpy[every, 2]
    style = {"color": COLOURS[column], "width": 0.002, "scale": 40.0, "headwidth": 4.0}
    ax.quiver(x[every], y[every], np.cos(yaw), np.sin(yaw), **style)


def _in_goals(values: Mapping[str, Any], column: str) -> float:
    value, goal = values[column], values["goal"]
    if values["better"] == "smaller":
        return float(value / goal)
    return float(goal / value) if value else math.inf
