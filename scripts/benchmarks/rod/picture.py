"""The picture of the release test: error over cost, with the Pareto front."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarks.rod.release import DAMPED, LARGEST_ERROR, OURS, UNDAMPED_SHEAR
from slot_core.report import palette

PANELS = {
    DAMPED.name: "With Kelvin-Voigt damping, without shear",
    UNDAMPED_SHEAR.name: "With shear, without damping",
}
COST, ERROR = (2e-4, 5.0), (2e-2, 60.0)  # limits of the axes
SCHEMES = {  # mark and name by theta and iterations
    (0.5, 1): ("o", "midpoint rule, 1 iteration"),
    (0.5, 2): ("s", "midpoint rule, 2 iterations"),
    (0.5, 20): ("D", "midpoint rule, converged"),
    (0.55, 2): ("v", "theta 0.55, 2 iterations"),
}
PEERS = {
    "MuJoCo hinge chain": "X",
    "PyElastica, clamp as documented": "P",
    "PyElastica, clamp moved": "*",
}


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the picture: one panel for each kind of physics that a peer shares."""
    figure = Figure(figsize=(12, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    nodes = sorted({row["nodes"] for row in rows if row["simulator"] == OURS})
    colours = dict(zip(nodes, [*palette.STAGE_COLOURS, palette.TRUE]))
    for ax, (physics, title) in zip(figure.subplots(1, 2, sharey=True), PANELS.items()):
        shown = [row for row in rows if row["physics"] == physics and row["percent"] < ERROR[1]]
        panel(ax, shown, colours)
        ax.set_title(title, loc="left")
    figure.axes[0].set_ylabel("error of the tip, % of its first deflection")
    figure.suptitle("Release of the leg: error against cost; left and below is better")
    figure.legend(handles=legend(colours), loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(path, dpi=130)


def panel(ax: Axes, rows: Sequence[Mapping[str, Any]], colours: Mapping[int, str]) -> None:
    """All rows of one kind of physics."""
    for row in rows:
        mark, colour, size = look(row, colours)
        face = colour if row["front"] else "none"
        ax.scatter(
            row["cpu_s"], row["percent"], size, marker=mark, edgecolors=colour, facecolors=face,
            linewidths=1.0, zorder=3 if row["front"] else 2,
        )  # fmt: skip
        if row["simulator"] != OURS:
            ax.annotate(
                str(row["nodes"]), (row["cpu_s"], row["percent"]), xytext=(7, -3), fontsize=7,
                textcoords="offset points", color=palette.INK,
            )  # fmt: skip
    front = sorted((row["cpu_s"], row["percent"]) for row in rows if row["front"])
    ax.step(*zip(*front), where="post", color=palette.TRUE, lw=1.2, zorder=1)
    ax.axhline(LARGEST_ERROR, color=palette.INK, lw=0.8, ls=":")
    ax.grid(visible=True, which="major", color=palette.PALE, lw=0.5)
    ax.set(
        xscale="log", yscale="log", xlim=COST, ylim=ERROR,
        xlabel="CPU seconds per simulated second",
    )  # fmt: skip


def look(row: Mapping[str, Any], colours: Mapping[int, str]) -> tuple[str, str, float]:
    """Mark, colour and size of a row."""
    if row["simulator"] == OURS:
        return SCHEMES[row["theta"], row["iterations"]][0], colours[row["nodes"]], 26.0
    return PEERS[row["simulator"]], palette.INK, 60.0


def legend(colours: Mapping[int, str]) -> list[Line2D]:
    """Legend of colours, marks and lines."""

    def entry(label: str, mark: str, colour: str, line: str = "") -> Line2D:
        return Line2D([], [], marker=mark, color=colour, mfc="none", ls=line, label=label)

    return [
        *(entry(f"{nodes} nodes", "o", colour) for nodes, colour in colours.items()),
        *(entry(name, mark, palette.INK) for mark, name in SCHEMES.values()),
        *(entry(f"{name} (nodes)", mark, palette.INK) for name, mark in PEERS.items()),
        entry("Pareto front (filled marks)", "", palette.TRUE, "-"),
        entry(f"goal: {LARGEST_ERROR:g} %", "", palette.INK, ":"),
    ]
