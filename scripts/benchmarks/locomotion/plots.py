"""The plots of the locomotion benchmark: table, velocities in all directions, top views.

They show the policies of `MARKS`; those of the paper are left out, since they do not walk.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.locomotion.cases import ALONE, DEFAULT, LEARNED, Case, WalkMotion
from benchmarks.locomotion.rows import CAUGHT_UP, SIDE, directions, slanted, square
from slot_core.arrays import Array
from slot_core.drawing import palette


class Mark(NamedTuple):
    """How all plots show a policy."""

    marker: str
    size: float
    colour: str


MARKS = {
    ALONE: Mark("|", 9, palette.INK),
    "place": Mark("o", 5, "#009E73"),
    LEARNED: Mark("^", 5, "#CC79A7"),
    DEFAULT: Mark("D", 6, palette.TRUE),
}
"""By column; the default last, over the others."""
SHOWN = (0.05, 100.0)  # in goals
SEED = 1  # of the motions that are shown
HEADING_EVERY = 4.0  # s, of the arrows on a track
SQUARE, SLANTED, VELOCITY = "square of .6 m", "path of 60 deg", "velocity"
Motions = Mapping[tuple[Case, str, int], WalkMotion]
Courses = Mapping[str, Array]


def courses(quick: bool, motions: Motions) -> dict[str, Array]:
    """Curves for `draw_velocity` and `draw_top` by plot and policy, of the motions that there are.

    velocity: (n, 4) commanded and reached v_x, v_y, m/s; the others: (n, 4) time, x, y, yaw.
    """
    found = {}
    for column in MARKS:
        ways = [case for case in directions(quick) if (case, column, SEED) in motions]
        if ways:
            pairs = [
                [*way.velocity[:2], *reached(motions[way, column, SEED])]
                for way in ways
            ]
            found[f"{VELOCITY}/{column}"] = np.array(pairs)
        for name, case in ((SQUARE, square()), (SLANTED, slanted())):
            if (motion := motions.get((case, column, SEED))) is not None:
                place = [motion.time, *motion.position.T[:2], motion.rpy[:, 2]]
                found[f"{name}/{column}"] = np.column_stack(place)
    return found


def reached(motion: WalkMotion) -> Array:
    """Mean v_x, v_y after the start, m/s."""
    return motion.after(CAUGHT_UP).velocity[:2]


def draw_table(table: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Every row as a multiple of its goal, the default beside its rivals; a fall is at the right.

    A line leads from the gait alone to the default.
    """
    figure = Figure(figsize=(8.0, 1.0 + 0.165 * len(table)), layout="constrained")
    ax = figure.subplots()
    ax.axvspan(SHOWN[0], 1.0, color=palette.SHADE, zorder=0)
    place = np.arange(len(table))
    shown = {
        column: np.clip([_in_goals(values, column) for values in table], *SHOWN)
        for column in MARKS
    }
    ax.hlines(place, shown[ALONE], shown[DEFAULT], color=palette.PALE, lw=2.0, zorder=1)
    for column, mark in MARKS.items():
        ax.plot(shown[column], place, label=column, **_style(mark))
    names = [f"{values['row']}, {values['unit']}".rstrip(", ") for values in table]
    ax.set_yticks(place, names, fontsize=8)
    ax.tick_params(axis="y", length=0)
    ax.set(
        xscale="log",
        xlim=SHOWN,
        ylim=(len(table) - 0.5, -0.5),
        xlabel="error over goal",
    )
    ax.grid(color=palette.PALE, lw=0.4)
    ax.set_axisbelow(True)
    _add_legend(
        figure, ax, "error of the policies over the goal of each row; shaded: holds"
    )
    figure.savefig(path, dpi=130)


def draw_velocity(found: Courses, path: Path) -> None:
    """Commanded (circles) and reached mean velocity (marks) in all directions that were run."""
    figure = Figure(figsize=(6.5, 7.5), layout="constrained")
    ax = figure.subplots()
    wanted = found[f"{VELOCITY}/{DEFAULT}"][:, :2]
    ax.plot(
        *wanted.T, "o", color=palette.TORSO, fillstyle="none", ms=16, label="commanded"
    )
    for column, mark in MARKS.items():
        if (pairs := found.get(f"{VELOCITY}/{column}")) is not None:
            ax.plot(pairs[:, ::2].T, pairs[:, 1::2].T, color=mark.colour, lw=0.8)
            ax.plot(*pairs[:, 2:].T, label=column, **_style(mark))
    ax.set(xlabel="v_x, m/s", ylabel="v_y, m/s", aspect="equal")
    ax.grid(color=palette.PALE, lw=0.4)
    _add_legend(figure, ax, "mean velocity, reached and commanded", columns=3)
    figure.savefig(path, dpi=130)


def draw_top(found: Courses, path: Path) -> None:
    """The square and the slanted path from above."""
    figure = Figure(figsize=(8.0, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2.2, 1.0))
    corners = np.array([[0, 0], [SIDE, 0], [SIDE, SIDE], [0, SIDE], [0, 0]])
    commanded = ((left, SQUARE, corners), (right, SLANTED, np.array(slanted().path)))
    for ax, name, line in commanded:
        for column, mark in MARKS.items():
            if (track := found.get(f"{name}/{column}")) is not None:
                _draw_track(ax, track, column, mark.colour)
        ax.plot(*line.T, "--", color=palette.INK, lw=1.2, label="commanded", zorder=3)
        ax.set(xlabel="x, m", ylabel="y, m", aspect="equal", title=name)
        ax.grid(color=palette.PALE, lw=0.4)
    _add_legend(figure, right, "")
    figure.savefig(path, dpi=130)


def _draw_track(ax: Axes, track: Array, label: str, colour: str) -> None:
    """The torso's track (n, 4), with its heading at times."""
    time, x, y, yaw = track.T
    ax.plot(x, y, color=colour, lw=1.6, label=label)
    every = slice(None, None, round(HEADING_EVERY / (time[1] - time[0])))
    style = {"color": colour, "width": 0.004, "scale": 25.0, "headwidth": 4.0}
    ax.quiver(x[every], y[every], np.cos(yaw[every]), np.sin(yaw[every]), **style)


def _style(mark: Mark) -> dict[str, Any]:
    hollow = "none" if mark.marker == "o" else "full"
    return {
        "marker": mark.marker,
        "ms": mark.size,
        "color": mark.colour,
        "ls": "none",
        "fillstyle": hollow,
    }


def _add_legend(figure: Figure, ax: Axes, title: str, columns: int = 6) -> None:
    handles, labels = ax.get_legend_handles_labels()
    place: Any = "outside lower center"
    figure.legend(handles, labels, loc=place, ncols=columns, frameon=False, fontsize=9)
    if title:
        figure.suptitle(title, fontsize=11)


def _in_goals(values: Mapping[str, Any], column: str) -> float:
    """Error in goals, infinite after a fall, NaN where the column was not run."""
    value, goal = values.get(column, ""), values["goal"]
    if value == "":
        return math.nan
    if value is None or math.isnan(value):
        return math.inf
    if values["better"] == "smaller":
        return float(value / goal)
    return float(goal / value) if value else math.inf
