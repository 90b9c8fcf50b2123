"""Plot that several benchmarks share: error over cost."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from slot_core.drawing import palette


class CostCurve(NamedTuple):
    """Runs of a simulator or solver: (cost, error, label) each, those on its front connected."""

    name: str
    marker: str
    colour: str
    runs: Sequence[tuple[float, float, str]]
    front: Sequence[tuple[float, float, str]]


def draw_error_over_cost(
    series: Sequence[CostCurve], path: Path, **axes: Any
) -> None:
    """Write the plot, logarithmic: all runs pale, those on a front with a line and their labels.

    `axes` are the properties of the axes: labels, limits and title.
    """
    figure = Figure(figsize=(8.5, 5.6), layout="constrained")
    ax = figure.subplots()
    ax.set(xscale="log", yscale="log", **axes)
    for name, marker, colour, runs, front in series:
        if runs:
            cost, error, _ = zip(*runs)
            ax.plot(cost, error, marker, color=colour, ms=4, mew=0, alpha=0.3)
        if front:
            cost, error, _ = zip(*sorted(front))
            ax.plot(
                cost, error, marker=marker, color=colour, lw=1.3, label=name
            )
        for *place, label in front:
            ax.annotate(
                label, place, (5, 4), textcoords="offset points", fontsize=8
            )
    ax.grid(color=palette.PALE, lw=0.5)
    ax.legend(frameon=False, fontsize=9)
    figure.savefig(path, dpi=130)
