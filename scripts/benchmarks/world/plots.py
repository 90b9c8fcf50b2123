"""The picture of the table: sets over gaits, coloured by the verdict, with the ratio of speed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from benchmarks.world.sets import (
    FAILS,
    REFUSED,
    STOPS,
    VERDICTS,
    WALKS,
    WARNED,
)
from slot_core.drawing import palette

COLOURS = {
    WALKS: "#8fd3b6",
    WARNED: "#f3e37c",
    REFUSED: "#a9cfee",
    STOPS: "#f0b860",
    FAILS: "#e07b6a",
}
PANELS = 3
Rows = Sequence[Mapping[str, Any]]


def draw(rows: Rows, path: Path) -> None:
    """Write the matrix; of several seeds the worst verdict, and the ratio farthest from one."""
    names = [*dict.fromkeys(row["set"] for row in rows)]
    gaits = [*dict.fromkeys(row["gait"] for row in rows)]
    high = -(-len(names) // PANELS)
    figure = Figure(figsize=(15.0, 1.3 + 0.26 * high), layout="constrained")
    for k, ax in enumerate(figure.subplots(1, PANELS, squeeze=False).flat):
        _draw_part(ax, names[k * high : (k + 1) * high], gaits, rows)
        ax.set_ylim(high, 0)
    figure.legend(
        handles=[
            *(
                Patch(color=COLOURS[verdict], label=f"{verdict}: {text}")
                for verdict, text in VERDICTS.items()
            ),
            Patch(
                fill=False, edgecolor=palette.INK, lw=1.6, label="not allowed"
            ),
        ],
        loc="outside lower center",
        ncols=3,
        frameon=False,
        fontsize=9,
    )
    figure.suptitle(
        "Sensors, legs and floors that are not its own, under the supervisor:"
        " speed over the reference's",
        fontsize=11,
    )
    figure.savefig(path, dpi=130)


def _draw_part(
    ax: Axes, names: Sequence[str], gaits: Sequence[str], rows: Rows
) -> None:
    """A cell for each set and gait."""
    for y, name in enumerate(names):
        for x, gait in enumerate(gaits):
            _draw_cell(
                ax,
                x,
                y,
                [r for r in rows if (r["set"], r["gait"]) == (name, gait)],
            )
    ax.set_yticks([y + 0.5 for y in range(len(names))], names, fontsize=8.5)
    ax.set_xticks([x + 0.5 for x in range(len(gaits))], gaits, fontsize=9)
    ax.tick_params(length=0, labeltop=True, labelbottom=False)
    ax.set_xlim(0, len(gaits))
    ax.spines[:].set_visible(False)


def _draw_cell(ax: Axes, x: int, y: int, runs: Rows) -> None:
    worst = max(runs, key=lambda r: [*VERDICTS].index(r["verdict"]))
    ratios = [r["ratio"] for r in runs if r["gait"] != "stand"]
    text = f"{max(ratios, key=lambda q: abs(q - 1)):.2f}" if ratios else ""
    if worst["verdict"] == REFUSED:
        text = REFUSED
    framed = not all(r["allowed"] for r in runs)
    ax.add_patch(
        Rectangle(
            (x + 0.03, y + 0.06),
            0.94,
            0.88,
            facecolor=COLOURS[worst["verdict"]],
            edgecolor=palette.INK if framed else "none",
            lw=1.6,
        )
    )
    ax.text(x + 0.5, y + 0.5, text, ha="center", va="center", fontsize=8.5)
