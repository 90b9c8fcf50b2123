"""The plot of the perturbations: cost and motion over time."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_paper.perturbations import CASES, HEIGHT, HEIGHT_BAND, TABLE, TILT_BAND

COLOURS = dict(
    zip(CASES, (palette.INK, palette.TRUE, *palette.STAGE_COLOURS, palette.TORSO))
)
STYLES = {"Roll": "--", "Velocity": "-.", "Noise": ":"}
SHOWN = 2.0  # s, of the robot


def draw_courses(courses: Mapping[str, Any], path: Path) -> None:
    """Draw runs, of which `courses` holds arrays by study, case and field.

    Maximum cost beside the paper's; height and tilt of the robot, shaded where it is settled.
    """
    figure = Figure(figsize=(8, 8), layout="constrained")
    costs, height, leaning = figure.subplots(3, 1, height_ratios=(1.4, 1, 1))
    most = [float(courses[f"published/{case}/cost"].max()) for case in CASES]
    _draw_costs(costs, most)
    band = 1e3 * HEIGHT_BAND
    for case in CASES:
        time = courses[f"robot/{case}/time"]
        _draw_line(height, case, time, 1e3 * (courses[f"robot/{case}/height"] - HEIGHT))
        _draw_line(leaning, case, time, np.degrees(courses[f"robot/{case}/tilt"]))
    height.axhspan(-band, band, color=palette.SHADE, zorder=0)
    leaning.axhspan(0.0, math.degrees(TILT_BAND), color=palette.SHADE, zorder=0)
    height.set(ylabel="height less 40 mm (mm)", xticklabels=[])
    height.set_title(
        "the default policy on the Cosserat robot, standing", fontsize=9, loc="left"
    )
    leaning.set(ylabel="tilt (deg)", xlabel="time (s)", ylim=(0.0, None))
    for axes, settled in ((height, 1.4), (leaning, 0.4)):
        axes.set(xlim=(0.0, SHOWN))
        axes.grid(color=palette.PALE, lw=0.4)
        axes.text(0.98 * SHOWN, settled, "settled", ha="right", va="center", fontsize=8)
    handles, names = height.get_legend_handles_labels()
    place = {"loc": "outside lower center", "ncols": len(names)}
    figure.legend(handles, names, **place, frameon=False, fontsize=8)
    figure.savefig(path, dpi=130)


def _draw_costs(axes: Axes, most: list[float]) -> None:
    """A line from the paper's maximum cost to the one found here, for each case."""
    places, paper = range(len(CASES)), [TABLE[case][0] for case in CASES]
    axes.hlines(places, paper, most, color=palette.PALE, lw=2, zorder=1)
    axes.plot(most, places, "o", color=palette.INK, label="here")
    mark = {"ms": 14, "mew": 2, "color": palette.TRUE, "label": "the paper's table"}
    axes.plot(paper, places, "|", **mark)
    axes.set(yticks=places, yticklabels=CASES, xlabel="maximum cost of the MPC")
    axes.set(xlim=(0.0, None))
    axes.invert_yaxis()
    axes.grid(axis="x", color=palette.PALE, lw=0.4)
    axes.legend(loc="upper left", fontsize=8, frameon=False)
    axes.set_title(
        "the published problem on its own linear model", fontsize=9, loc="left"
    )


def _draw_line(axes: Axes, case: str, time: Array, value: Array) -> None:
    style = {"color": COLOURS[case], "ls": STYLES.get(case, "-"), "lw": 1.3}
    axes.plot(time, value, label=case, **style)
