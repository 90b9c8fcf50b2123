"""The plot of the perturbations: cost and motion over time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.perturbations.cases import (
    CASES,
    HEIGHT,
    HEIGHT_BAND,
    TABLE,
    TILT_BAND,
    PerturbedRun,
    runs_of,
)
from slot_core.arrays import Array
from slot_core.drawing import palette

Row = Mapping[str, Any]

STUDIES = {
    "published": "the published problem on its own linear model",
    "robot": "the default policy on the Cosserat robot, standing",
}
COLOURS = dict(
    zip(CASES, (palette.INK, palette.TRUE, *palette.STAGE_COLOURS, palette.TORSO))
)
STYLES = {"Roll": "--", "Velocity": "-.", "Noise": ":"}
SHOWN = 2.0  # s, of the robot


def draw_courses(courses: Mapping[str, Any], path: Path) -> None:
    """Draw the runs of stored courses."""
    draw_responses(runs_of(courses), path)


def draw_responses(runs: Mapping[str, Mapping[str, PerturbedRun]], path: Path) -> None:
    """Maximum cost beside the paper's; height and tilt of the robot, shaded where it is settled."""
    figure = Figure(figsize=(8, 8), layout="constrained")
    costs, height, leaning = figure.subplots(3, 1, height_ratios=(1.4, 1, 1))
    _draw_costs(costs, runs["published"])
    _draw_lines(height, runs["robot"], lambda run: 1e3 * (run.height - HEIGHT))
    height.axhspan(-1e3 * HEIGHT_BAND, 1e3 * HEIGHT_BAND, color=palette.SHADE, zorder=0)
    height.set(ylabel="height less 40 mm (mm)", xticklabels=[], xlim=(0.0, SHOWN))
    height.set_title(STUDIES["robot"], fontsize=9, loc="left")
    _draw_lines(leaning, runs["robot"], lambda run: np.degrees(run.tilt))
    leaning.axhspan(0.0, math.degrees(TILT_BAND), color=palette.SHADE, zorder=0)
    leaning.set(
        ylabel="tilt (deg)", xlabel="time (s)", xlim=(0.0, SHOWN), ylim=(0.0, None)
    )
    for axes, settled in ((height, 1.4), (leaning, 0.4)):
        axes.text(0.98 * SHOWN, settled, "settled", ha="right", va="center", fontsize=8)
    handles, names = height.get_legend_handles_labels()
    place = {"loc": "outside lower center", "ncols": len(names)}
    figure.legend(handles, names, **place, frameon=False, fontsize=8)
    figure.savefig(path, dpi=130)


def _draw_costs(axes: Axes, runs: Mapping[str, PerturbedRun]) -> None:
    """A line from the paper's maximum cost to the one found here, for each case."""
    for place, (name, run) in enumerate(runs.items()):
        paper, found = TABLE[name][0], float(run.cost.max())
        axes.plot([paper, found], [place, place], color=palette.PALE, lw=2, zorder=1)
        axes.plot(
            found, place, "o", color=palette.INK, label="here" if place == 0 else None
        )
        axes.plot(
            paper,
            place,
            "|",
            ms=14,
            mew=2,
            color=palette.TRUE,
            label="the paper's table" if place == 0 else None,
        )
    axes.set(
        yticks=range(len(runs)),
        yticklabels=list(runs),
        xlabel="maximum cost of the MPC",
    )
    axes.set(xlim=(0.0, None))
    axes.invert_yaxis()
    axes.grid(axis="x", color=palette.PALE, lw=0.4)
    axes.legend(loc="upper left", fontsize=8, frameon=False)
    axes.set_title(STUDIES["published"], fontsize=9, loc="left")


def _draw_lines(
    ax: Axes, runs: Mapping[str, PerturbedRun], value: Callable[[PerturbedRun], Array]
) -> None:
    for name, run in runs.items():
        style = {"color": COLOURS[name], "ls": STYLES.get(name, "-"), "lw": 1.3}
        ax.plot(run.time, value(run), label=name, **style)
    ax.grid(color=palette.PALE, lw=0.4)


def table_lines(rows: Sequence[Row]) -> list[str]:
    """Cases down; the paper, the published problem and the robot across."""
    found = {(row["study"], row["case"]): row for row in rows if row["kind"] == "case"}
    costs, times = "     max    mean   final", "   cost s  still s  inf."
    head = f"{'':<10}{'paper':^34}|{'published':^50}| robot"
    lines = [head, f"{'':<10}{costs}   settled|{costs}{times}  |{times[9:]}"]
    for case, (most, mean, final, settled) in TABLE.items():
        line = f"{case:<10}{most:8.4f}{mean:8.4f}{final:8.4f}{_time(settled):>10}|"
        if row := found.get(("published", case)):
            line += "".join(
                f"{row[f'{name}_cost']:8.4f}" for name in ("max", "mean", "final")
            )
            line += f"{_time(row['settling_cost_s']):>9}{_still(row)}  |"
        if row := found.get(("robot", case)):
            line += _still(row)
        lines.append(line)
    return lines


def _still(row: Row) -> str:
    return f"{_time(row['settling_s']):>9}{row['infeasible']:>6}"


def _time(seconds: float) -> str:
    return f"{seconds:.3f}" if np.isfinite(seconds) else "-"
