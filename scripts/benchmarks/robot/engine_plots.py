"""The plot of the replays in two engines: mean speed of each gait over the floor's friction."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from slot_core.drawing import palette

ENGINES = (("own", "rod legs of this project", palette.TRUE, "o"),
           ("other", "hinge chains in MuJoCo", palette.SECONDARY, "s"))  # fmt: skip
APART = 0.08  # of the places of two engines at one friction, in units of its place


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
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
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.savefig(path, dpi=150)


def draw_gait(ax: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    """Speeds of one gait; the shade is the goal around our speed."""
    for k, row in enumerate(rows):
        low, size = row["own_v_x"] - row["goal"], 2 * row["goal"]
        label = "goal: within 10 % or 3 mm/s" if k == 0 else None
        ax.bar(k, size, 0.5, low, color=palette.SHADE, edgecolor=palette.PALE, label=label)
    for side, (name, label, colour, mark) in zip((-APART, APART), ENGINES):
        places = [k + side for k in range(len(rows))]
        speeds = [row[f"{name}_v_x"] for row in rows]
        ax.plot(places, speeds, mark, color=colour, label=label)
    ax.set_xticks(range(len(rows)), [f"{row['friction']:g}" for row in rows])
    ax.set_xlim(-0.6, len(rows) - 0.4)
