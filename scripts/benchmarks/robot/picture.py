"""The picture of the robot's benchmark: error over cost, model levels and the Pareto front."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from slot_core.report import palette

MARKS = {5e-3: "v", 2e-3: "^", 1e-3: "o", 5e-4: "s", 2.5e-4: "D"}


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the picture of all rows with an error and a cost."""
    figure = Figure(figsize=(10, 6), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    runs = [row for row in rows if row["kind"] == "stand and step" and row["error_mm"] < math.inf]
    nodes = sorted({row["nodes"] for row in runs})
    colour = dict(zip(nodes, [*palette.STAGE_COLOURS, palette.TRUE, palette.INK]))
    for row in runs:
        scatter(ax, row, colour[row["nodes"]])
    draw_levels(ax, [row for row in rows if row["kind"] == "level"])
    front = sorted((row["us_per_ms"], row["error_mm"]) for row in rows if row.get("front"))
    ax.step(*zip(*front), where="post", color=palette.INK, lw=1.0, zorder=0)
    add_legend(ax, colour)
    ax.set(
        xscale="log", yscale="log", xlim=(0.3, 110), ylim=(0.01, 30),
        xlabel="CPU microseconds per simulated millisecond, whole robot",
        ylabel="error of the torso's centre, mm RMS",
        title="Stand up and step, 1.5 s: error against 121 nodes at 10 us",
    )  # fmt: skip
    ax.grid(which="major", color=palette.PALE, lw=0.5)
    figure.savefig(path, dpi=150)


def scatter(ax: Axes, row: Mapping[str, Any], colour: str) -> None:
    """One run: colour for the nodes, mark for the step, fill and size for the scheme."""
    theta, iterations = row["theta"], row["iterations"]
    face = {0.5: "none", 0.55: colour, 1.0: palette.PALE}[theta]
    size = {1: 14, 2: 30, 4: 50}[iterations]
    mark = MARKS[row["step"]]
    ax.scatter(
        row["us_per_ms"], row["error_mm"], size, marker=mark, edgecolors=colour,
        facecolors=face, linewidths=1.0,
    )  # fmt: skip


def draw_levels(ax: Axes, levels: Sequence[Mapping[str, Any]]) -> None:
    """The model levels of `config/solver`, with their names."""
    for row in levels:
        if row["error_mm"] < math.inf:
            place = (row["us_per_ms"], row["error_mm"])
            ax.plot(*place, "*", ms=15, mfc="none", mec=palette.INK, mew=1.4)
            ax.annotate(row["level"], place, (7, 7), textcoords="offset points", weight="bold")


def add_legend(ax: Axes, colour: Mapping[int, str]) -> None:
    """Legend of colours, marks, fills and sizes."""
    for nodes, name in colour.items():
        ax.plot([], [], "o", color=name, label=f"{nodes} nodes")
    for step, mark in MARKS.items():
        ax.plot([], [], mark, color=palette.INK, mfc="none", label=f"{1e3 * step:g} ms")
    ink, pale = palette.INK, palette.PALE
    for face, name in (("none", "midpoint"), (ink, "theta 0.55"), (pale, "backward Euler")):
        ax.plot([], [], "o", color=ink, mfc=face, label=name)
    for size, iterations in ((4, 1), (5.5, 2), (7, 4)):
        name = f"{iterations} iteration" + "s" * (iterations > 1)
        ax.plot([], [], "o", color=ink, mfc="none", ms=size, label=name)
    ax.plot([], [], "*", color=ink, mfc="none", ms=12, label="levels of config/solver")
    ax.plot([], [], color=ink, lw=1.0, label="Pareto front")
    ax.legend(fontsize=8, ncols=1, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
