"""The plot of the release test: error over cost of all simulators, with their Pareto fronts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.rod.release import DAMPED, LARGEST_ERROR, OURS, UNDAMPED
from slot_core.drawing import palette

COST, ERROR = (5e-4, 5.0), (8e-3, 100.0)  # limits of the axes
CURVES = {  # simulator and physics: name, mark, colour
    (OURS, DAMPED.name): ("CosseratRod, damped", "o", palette.STAGE_COLOURS[0]),
    ("MuJoCo hinge chain", DAMPED.name): (
        "MuJoCo hinge chain, damped",
        "X",
        palette.STAGE_COLOURS[1],
    ),
    (OURS, UNDAMPED.name): ("CosseratRod, undamped", "D", palette.STAGE_COLOURS[2]),
    ("PyElastica, clamp as documented", UNDAMPED.name): (
        "PyElastica, undamped, clamp as documented",
        "P",
        palette.INK,
    ),
    ("PyElastica, clamp moved", UNDAMPED.name): (
        "PyElastica, undamped, clamp moved",
        "*",
        palette.TRUE,
    ),
}


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the plot."""
    figure = Figure(figsize=(9.5, 6.6), layout="constrained")
    ax = figure.subplots()
    for (simulator, physics), look in CURVES.items():
        own = [
            row
            for row in rows
            if (row["simulator"], row["physics"]) == (simulator, physics)
        ]
        curve(ax, own, *look)
    ax.axhline(LARGEST_ERROR, color=palette.INK, lw=0.8, ls=":")
    ax.grid(visible=True, which="major", color=palette.PALE, lw=0.5)
    ax.set(
        xscale="log",
        yscale="log",
        xlim=COST,
        ylim=ERROR,
        xlabel="CPU seconds per simulated second",
        ylabel="error of the tip, % of its first deflection",
    )
    ax.legend(frameon=False, loc="lower left")
    figure.suptitle(
        "Release of the leg from an oblique force: error against the own converged motion;\n"
        "lines: best of each, numbers: nodes, dotted: goal; left and below is better"
    )
    figure.savefig(path, dpi=130)


def curve(
    ax: Axes, rows: Sequence[Mapping[str, Any]], name: str, mark: str, colour: Any
) -> None:
    """All rows of a simulator, and the line through those that none of it surpasses."""
    shown = [row for row in rows if ERROR[0] < row["percent"] < ERROR[1]]
    front = sorted(
        (row["cpu_s"], row["percent"], row["nodes"]) for row in shown if row["front"]
    )
    ax.scatter(
        [row["cpu_s"] for row in shown],
        [row["percent"] for row in shown],
        12,
        marker=mark,
        color=colour,
        alpha=0.3,
        linewidths=0,
    )
    ax.plot(
        [cost for cost, _, _ in front],
        [error for _, error, _ in front],
        marker=mark,
        color=colour,
        lw=1.3,
        ms=6,
        label=name,
    )
    for cost, error, nodes in front:
        ax.annotate(
            str(nodes),
            (cost, error),
            xytext=(5, 4),
            fontsize=7,
            textcoords="offset points",
            color=palette.INK,
        )
