"""The plot of the servos' step responses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from slot_core.simulation.plant import CYCLE

STYLES = {"position": ("C0", "servo's own loop"), "pwm": ("C1", "loop on the host, PWM mode")}


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Write the plot: angles over time, dashed with load."""
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.add_subplot()
    for row in rows:
        colour, name = STYLES[row["control"]]
        times = 1e3 * CYCLE * np.arange(len(row["trace"]))
        style = "--" if row["load"] else "-"
        label = f"{name}, {row['load']:g} N m"
        axes.plot(times, row["trace"], style, color=colour, label=label, linewidth=1.2)
    axes.set(xlabel="time, ms", ylabel="tendon angle, rad", xlim=(0.0, 600.0))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)
