"""The plot of the robot's benchmark: error over cost, the model levels and the Pareto front."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slot_core.drawing import palette

BESIDE = {"coarse": (9, -22), "fine": (-95, -4)}  # points, of a name from its level
RANGE = {"xlim": (0.3, 300), "ylim": (0.01, 30)}


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the plot of all rows with an error and a cost."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    ax = figure.subplots()
    runs = [row for row in rows if row["kind"] == "stand and step" and row["error_mm"] < math.inf]
    ax.plot(
        *zip(*((row["us_per_ms"], row["error_mm"]) for row in runs)),
        "o", color=palette.PALE, ms=4, mew=0, label="schemes, nodes and steps",
    )  # fmt: skip
    front = sorted((row["us_per_ms"], row["error_mm"]) for row in rows if row.get("front"))
    ax.step(*zip(*front), where="post", color=palette.INK, lw=1.0, label="Pareto front")
    draw_levels(ax, [row for row in rows if row["kind"] == "level"])
    ax.set(
        xscale="log", yscale="log", **RANGE,
        xlabel="CPU microseconds per simulated millisecond, whole robot",
        ylabel="error of the torso's centre, mm RMS",
        title="Stand up and step, 1.5 s: error against 121 nodes at 10 us",
    )  # fmt: skip
    ax.grid(which="major", color=palette.PALE, lw=0.5)
    ax.legend(loc="upper right", frameon=False)
    figure.savefig(path, dpi=150)


def draw_levels(ax: Axes, levels: Sequence[Mapping[str, Any]]) -> None:
    """The model levels of `config/solver`, with their names, nodes and steps."""
    for row in levels:
        if row["error_mm"] < math.inf:
            place = (row["us_per_ms"], row["error_mm"])
            ax.plot(*place, "o", ms=9, color=palette.TRUE, zorder=3)
            text = f"{row['level']}\n{1e3 * row['step']:g} ms"
            if row["level"] != "map":
                text += f", {row['nodes']} nodes"
            beside = BESIDE.get(row["level"], (9, 4))
            ax.annotate(text, place, beside, textcoords="offset points", fontsize=9)
