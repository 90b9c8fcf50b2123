"""The plots of the locomotion benchmark: ten rows, velocities in all directions, top views.

They show the policies of `COLOURS`; the paper's are left out, since they do not walk.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.locomotion.cases import (
    ALONE,
    DEFAULT,
    LEARNED,
    Case,
    WalkMotion,
)
from benchmarks.locomotion.rows import (
    CAUGHT_UP,
    SIDE,
    directions,
    slanted,
    square,
)
from slot_core.arrays import Array
from slot_core.drawing import palette

COLOURS = {
    ALONE: palette.TORSO,
    "place": "#009E73",
    LEARNED: "#CC79A7",
    DEFAULT: palette.TRUE,
}
"""By column of the table."""
NAMES = {
    ALONE: "gait alone",
    "place": "feedback of the place",
    LEARNED: "learned network",
    DEFAULT: "default: rollout MPC",
}
SHOWN = {
    "v_x held, .02 to .055, mu .2 to .6": "Speeds of 20 to 55 mm/s: error",
    "v of .06 held in all directions": "60 mm/s in all directions: error",
    "lateral error, split friction": "Right feet slip more: off a line of 0.8 m",
    "corner by path, RMS": "Path with a corner of 90 deg: off the path, RMS",
    "square of .6 m closes": "Square of 0.6 m by commands: gap at its end",
    "turn in place, 90 deg": "Turn in place by 90 deg: angle missed",
    "slope 5 deg, v_x of 0.04": "Uphill 5 deg at 40 mm/s: speed missed",
    "payload .3 kg off centre, at once: place lost": "0.3 kg put on: place lost in 6 s",
    "push of .83 N s aside: peak": "Push of 0.83 N s from the side: place lost",
    "tendons +-.5 mm: off the path after .8 m": "Tendons wrong by 0.5 mm: off the line",
}
"""Rows of the table that are drawn, and what they are for a stranger; all are errors."""
SEED = 1  # of the motions that are shown
HEADING_EVERY = 4.0  # s, of the arrows on a track
SQUARE, SLANTED, VELOCITY = "square of .6 m", "path of 60 deg", "velocity"
Motions = Mapping[tuple[Case, str, int], WalkMotion]
Courses = Mapping[str, Array]


def courses(motions: Motions) -> dict[str, Array]:
    """Curves for `draw_velocity` and `draw_top` by plot and policy, of the motions that there are.

    velocity: (n, 4) commanded and reached v_x, v_y, m/s; the others: (n, 4) time, x, y, yaw.
    """
    found = {}
    for column in COLOURS:
        ways = [
            case for case in directions() if (case, column, SEED) in motions
        ]
        pairs = [
            [
                *way.velocity[:2],
                *motions[way, column, SEED].after(CAUGHT_UP).velocity[:2],
            ]
            for way in ways
        ]
        if pairs:
            found[f"{VELOCITY}/{column}"] = np.array(pairs)
        for name, case in ((SQUARE, square()), (SLANTED, slanted())):
            if (motion := motions.get((case, column, SEED))) is not None:
                found[f"{name}/{column}"] = np.column_stack(
                    [motion.time, *motion.position.T[:2], motion.rpy[:, 2]]
                )
    return found


def draw_table(table: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the rows of `SHOWN`, a panel each: a bar for the error of each policy, and the goal."""
    by_name = {row["row"]: row for row in table}
    shown = [
        (by_name[name], title)
        for name, title in SHOWN.items()
        if name in by_name
    ]
    if not shown:
        return
    columns = [name for name in COLOURS if name in shown[0][0]]
    lines = math.ceil(len(shown) / 2)
    figure = Figure(figsize=(10.0, 0.9 + 1.35 * lines), layout="constrained")
    panels = figure.subplots(lines, 2, squeeze=False).flat
    for ax, (row, title) in zip(panels, shown):
        _draw_row(ax, row, columns)
        ax.set_title(f"{title}, {row['unit']}", fontsize=10, loc="left")
    for ax in [*panels]:  # the rest
        ax.set_axis_off()
    figure.suptitle(
        "What the controller changes: error by policy, less is better. "
        "Shaded: the goal is reached; black: its limit",
        fontsize=10,
    )
    figure.savefig(path, dpi=130)


def _draw_row(ax: Axes, row: Mapping[str, Any], columns: Sequence[str]) -> None:
    """A bar for each policy with its value; a policy that falls or does not walk has none."""
    values = [math.nan if row[name] is None else row[name] for name in columns]
    finite = [value for value in values if math.isfinite(value)]
    end = 1.2 * max([*finite, row["goal"]])
    ax.axvspan(0.0, row["goal"], color="#dcefe4", zorder=0)
    ax.axvline(row["goal"], color=palette.INK, lw=1.2, zorder=3)
    for place, (name, value) in enumerate(zip(columns, values)):
        text, at = "falls or does not walk", 0.0
        if math.isfinite(value):
            ax.barh(place, value, 0.65, color=COLOURS[name], zorder=2)
            text = f"{value:.0f}" if value >= 100 else f"{value:.3g}"
            at = max(value, row["goal"])  # not across the line
        ax.text(at + 0.01 * end, place, text, va="center", fontsize=8, zorder=4)
    ax.set_yticks(
        range(len(columns)), [NAMES[name] for name in columns], fontsize=8
    )
    ax.set(xlim=(0.0, end), ylim=(len(columns) - 0.5, -0.5))
    ax.tick_params(axis="y", length=0)
    ax.tick_params(axis="x", labelsize=8)
    ax.spines[["top", "right"]].set_visible(False)


def draw_velocity(found: Courses, path: Path) -> None:
    """Commanded (circles) and reached mean velocity (dots) in all directions that were run."""
    figure = Figure(figsize=(6.5, 7.0), layout="constrained")
    ax = figure.subplots()
    wanted = found[f"{VELOCITY}/{DEFAULT}"][:, :2]
    ax.plot(
        *wanted.T,
        "o",
        label="commanded",
        color=palette.INK,
        fillstyle="none",
        ms=16,
    )
    for column, colour in COLOURS.items():
        if (pairs := found.get(f"{VELOCITY}/{column}")) is not None:
            ax.plot(pairs[:, ::2].T, pairs[:, 1::2].T, color=colour, lw=0.8)
            ax.plot(
                *pairs[:, 2:].T, "o", ms=6, color=colour, label=NAMES[column]
            )
    ax.set(xlabel="v_x, m/s", ylabel="v_y, m/s", aspect="equal")
    ax.set_title("mean velocity, reached and commanded", fontsize=11)
    _finish(figure, ax, path)


def draw_top(found: Courses, path: Path) -> None:
    """The square and the slanted path from above, with the robot's heading at times."""
    figure = Figure(figsize=(8.0, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2.2, 1.0))
    corners = np.array([[0, 0], [SIDE, 0], [SIDE, SIDE], [0, SIDE], [0, 0]])
    commanded = (
        (left, SQUARE, corners),
        (right, SLANTED, np.array(slanted().path)),
    )
    for ax, name, line in commanded:
        for column, colour in COLOURS.items():
            if (track := found.get(f"{name}/{column}")) is not None:
                time, x, y, yaw = track.T
                ax.plot(x, y, color=colour, lw=1.6, label=NAMES[column])
                every = slice(
                    None, None, round(HEADING_EVERY / (time[1] - time[0]))
                )
                ax.quiver(
                    x[every],
                    y[every],
                    np.cos(yaw[every]),
                    np.sin(yaw[every]),
                    color=colour,
                    width=0.004,
                    scale=25.0,
                    headwidth=4.0,
                )
        ax.plot(
            *line.T,
            "--",
            color=palette.INK,
            lw=1.2,
            label="commanded",
            zorder=3,
        )
        ax.set(xlabel="x, m", ylabel="y, m", aspect="equal", title=name)
        ax.grid(color=palette.PALE, lw=0.4)
    _finish(figure, right, path)


def _finish(figure: Figure, ax: Axes, path: Path) -> None:
    ax.grid(color=palette.PALE, lw=0.4)
    figure.legend(
        *ax.get_legend_handles_labels(),
        loc="outside lower center",
        ncols=3,
        frameon=False,
        fontsize=9,
    )
    figure.savefig(path, dpi=130)
