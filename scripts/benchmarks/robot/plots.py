"""The plots of the robot's benchmark: error over cost, and the gaits' speeds in two engines.

Error over cost is shown with the model levels and the Pareto front, speeds over friction.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slot_core.drawing import palette

BESIDE = {"coarse": (-88, -30), "fine": (-90, -26)}  # points, of a name from its level
RANGE = {"xlim": (0.3, 300), "ylim": (0.006, 30)}
ENGINES = (
    ("own", "rod legs of this project", palette.TRUE, "o"),
    ("other", "hinge chains in MuJoCo", palette.SECONDARY, "s"),
)
APART = 0.08  # of the places of two engines at one friction, in units of its place


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the plot of all rows with an error and a cost."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    ax = figure.subplots()
    runs = [
        row
        for row in rows
        if row["kind"] == "stand and step" and row["error_mm"] < math.inf
    ]
    ax.plot(
        *zip(*((row["us_per_ms"], row["error_mm"]) for row in runs)),
        "o",
        color=palette.PALE,
        ms=4,
        mew=0,
        label="schemes, nodes and steps",
    )
    front = sorted(
        (row["us_per_ms"], row["error_mm"]) for row in rows if row.get("front")
    )
    ax.step(*zip(*front), where="post", color=palette.INK, lw=1.0, label="Pareto front")
    draw_levels(ax, [row for row in rows if row["kind"] == "level"])
    ax.set(
        xscale="log",
        yscale="log",
        **RANGE,
        xlabel="CPU microseconds per simulated millisecond, whole robot",
        ylabel="error of the torso's centre, mm RMS",
        title="Stand up and step, 1.5 s: error against 121 nodes at 10 us",
    )
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
            style = {
                "fontsize": 9,
                "bbox": {"fc": "white", "ec": "none", "pad": 0.5, "alpha": 0.85},
            }
            ax.annotate(
                text, place, beside, textcoords="offset points", zorder=2, **style
            )


def draw_engines(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the plot of the replays: a panel for each gait, a pair of points for each floor."""
    gaits = list(dict.fromkeys(row["gait"] for row in rows))
    figure = Figure(figsize=(1.2 + 3.0 * len(gaits), 4.2), layout="constrained")
    panels = figure.subplots(1, len(gaits), sharey=True, squeeze=False)[0]
    for ax, gait in zip(panels, gaits):
        draw_gait(ax, [row for row in rows if row["gait"] == gait])
        ax.set(title=gait, xlabel="friction of the floor")
        ax.grid(axis="y", color=palette.PALE, lw=0.5)
    panels[0].set_ylim(bottom=min(0.0, panels[0].get_ylim()[0]))
    panels[0].set_ylabel("mean speed, mm/s")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3
    )
    figure.savefig(path, dpi=150)


def draw_gait(ax: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    """Speeds of one gait; the shade is the goal around our speed."""
    for k, row in enumerate(rows):
        low, size = row["own_v_x"] - row["goal"], 2 * row["goal"]
        label = "goal: within 10 % or 3 mm/s" if k == 0 else None
        ax.bar(
            k, size, 0.5, low, color=palette.SHADE, edgecolor=palette.PALE, label=label
        )
    for side, (name, label, colour, mark) in zip((-APART, APART), ENGINES):
        places = [k + side for k in range(len(rows))]
        speeds = [row[f"{name}_v_x"] for row in rows]
        ax.plot(places, speeds, mark, color=colour, label=label)
    ax.set_xticks(range(len(rows)), [f"{row['friction']:g}" for row in rows])
    ax.set_xlim(-0.6, len(rows) - 0.4)
