"""The plot of the MPC's benchmark: error over CPU time, and CPU time over the horizon."""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slot_core.drawing import palette

COLOURS = (palette.TRUE, "#E69F00", "#009E73", "#CC79A7", "#D55E00")  # of the solvers
ROUNDOFF = 1e-13  # N, drawn for smaller errors


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the plot of all rows."""
    figure = Figure(figsize=(8, 8.5), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(3, 2))
    draw_errors(above, rows)
    draw_horizons(below, [row for row in rows if row["kind"] == "horizon"])
    figure.savefig(path, dpi=150)


def draw_errors(ax: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    """Largest error on the walk and the hard cases, over the median CPU time on the walk."""
    runs = [row for row in rows if row["kind"] == "solver"]
    for k, (name, colour) in enumerate(coloured(rows)):
        side = (
            -6 if k == 0 else 6
        )  # points, of the labels; the first solver is on the left
        mine = [row for row in runs if row["solver"] == name]
        places = [(row["median_ms"], worst(row)) for row in mine]
        ax.plot(*zip(*places), "-", color=colour, lw=0.8)
        for row, place in zip(mine, places):
            refused = row["hard_refused"] + row["walk_refused"]
            ax.plot(*place, "o", color=colour, mfc="none" if refused else colour, ms=6)
            note = f"{row['tolerance']:.0e}".replace("e-0", "e-")
            style = {
                "textcoords": "offset points",
                "size": 8,
                "color": colour,
                "va": "center",
            }
            ax.annotate(
                note, place, (side, 0), ha="left" if side > 0 else "right", **style
            )
        ax.plot([], [], "o-", color=colour, label=name)
    for row in rows:
        if row["kind"] == "cvxpy":
            place = (row["median_ms"], max(ROUNDOFF, row["error_max"]))
            ax.plot(*place, "s", color=palette.TORSO)
            style = {"textcoords": "offset points", "size": 8, "ha": "right"}
            ax.annotate(f"{row['solver']} (walk only)", place, (-5, 7), **style)
    front = sorted((row["median_ms"], worst(row)) for row in runs if row["front"])
    ax.step(
        *zip(*front),
        where="post",
        color=palette.INK,
        lw=1.2,
        ls=":",
        label="Pareto front",
    )
    ax.plot(
        [], [], "o", color=palette.INK, mfc="none", label="hollow: some cases refused"
    )
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="CPU ms per cycle of the controller, median of a walk",
        ylabel="largest error of a first force, walk and hard cases, N",
        title="Numbers at the marks: tolerance",
    )
    ax.margins(x=0.1)
    ax.grid(which="major", color=palette.PALE, lw=0.5)
    ax.legend(fontsize=8)


def coloured(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """The solvers of the rows, each with a colour."""
    names = dict.fromkeys(
        row["solver"] for row in rows if row["kind"] in ("solver", "horizon")
    )
    return list(zip(names, itertools.cycle(COLOURS)))


def worst(row: Mapping[str, Any]) -> float:
    """Largest error of the solutions found, N."""
    return max(
        ROUNDOFF,
        *(row[k] for k in ("error_max", "hard_error_max") if row[k] < math.inf),
    )


def draw_horizons(ax: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    """CPU time over the number of stages."""
    for name, colour in coloured(rows):
        places = [
            (row["stages"], row["median_ms"]) for row in rows if row["solver"] == name
        ]
        ax.plot(*zip(*places), "o-", color=colour, ms=4, label=name)
    ax.set(
        xlabel="stages of the horizon",
        ylabel="CPU ms per cycle, median",
        ylim=(0, None),
        title="Growth with the horizon",
    )
    ax.grid(color=palette.PALE, lw=0.5)
    ax.legend(fontsize=8)
