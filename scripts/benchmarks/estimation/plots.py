"""The plot of the estimation benchmark: error at the time of use over the odometry's delay."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from slot_core.drawing import palette

COLOURS = {
    "finite differences": "#E69F00",
    "without prediction": palette.SECONDARY,
    "predicted": palette.TRUE,
}
PANELS = {
    "position_mm": "position, mm",
    "velocity_mm_s": "velocity, mm/s",
    "roll_pitch_mrad": "roll and pitch, mrad",
    "rate_mrad_s": "angular velocity, mrad/s",
}


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the plot of the rows of kind `delay`."""
    figure = Figure(figsize=(12, 3.4), layout="constrained")
    for ax, (name, label) in zip(figure.subplots(1, len(PANELS)), PANELS.items()):
        for method, colour in COLOURS.items():
            mine = [r for r in rows if r["kind"] == "delay" and r["method"] == method]
            x, y = [r["delay_ms"] for r in mine], [r[name] for r in mine]
            ax.plot(x, y, "o-", color=colour, label=method)
        ax.set(
            xlabel="delay of the odometry, ms",
            ylabel=f"RMS error of {label}",
            yscale="log",
        )
        ax.grid(alpha=0.3)
    figure.axes[0].legend(frameon=False)
    figure.savefig(path, dpi=150)
