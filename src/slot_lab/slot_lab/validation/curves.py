"""Plots of a validation: coordinates of run and measurement over time, and their difference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from slot_core.drawing import palette
from slot_core.robot import LEG_POINTS, TORSO
from slot_lab.validation.comparison import AXES, Comparison, paper_points
from slot_lab.validation.recording import ATTITUDE
from slot_lab.validation.tables import scale, unit

DPI = 100


def draw(comparison: Comparison, title: str, out: Path) -> list[Path]:
    """Write `torso.png`, and `leg.png` or `FL_leg.png` for each leg; raises OSError."""
    written = []
    torso = [
        (TORSO, axis)
        for axis in (*AXES, *ATTITUDE)
        if (TORSO, axis) in comparison.series
    ]
    if torso:
        written.append(_figure(comparison, torso, f"{title}: torso", out / "torso.png"))
    for leg, points in paper_points(comparison).items():
        keys = [(points[name], "z") for name in LEG_POINTS]
        name = "_".join(filter(None, (leg, "leg.png")))
        written.append(
            _figure(comparison, keys, f"{title}: leg {leg}".rstrip(), out / name)
        )
    return written


def _figure(
    comparison: Comparison, keys: Sequence[tuple[str, str]], title: str, path: Path
) -> Path:
    figure = Figure(
        figsize=(11.0, 1.9 * len(keys) + 0.8), dpi=DPI, layout="constrained"
    )
    figure.suptitle(title, fontsize=12, fontweight="bold")
    axes = figure.subplots(
        len(keys), 2, sharex=True, squeeze=False, width_ratios=(1.6, 1.0)
    )
    for (both, difference), (point, axis) in zip(axes, keys):
        found, factor = comparison.series[point, axis], scale(axis)
        run, measured = factor * found.run, factor * found.measured
        both.plot(found.t, measured, ".", ms=2.5, color=palette.INK, label="measured")
        both.plot(found.t, run, color=palette.SECONDARY, lw=1.2, label="run")
        both.set_title(f"{point} {axis} ({unit(axis)})", fontsize=9, loc="left")
        difference.plot(found.t, run - measured, color=palette.TRUE, lw=0.8)
        difference.axhline(0.0, color=palette.INK, lw=0.6)
        rmse = f"RMSE {factor * found.errors.value['rmse']:.2f} {unit(axis)}"
        difference.set_title(f"run - measured, {rmse}", fontsize=9, loc="left")
    for ax in axes.flat:
        ax.tick_params(labelsize=8)
        ax.grid(color=palette.SHADE)
    axes[0][0].legend(fontsize=8, frameon=False, ncols=2)
    for ax in axes[-1]:
        ax.set_xlabel("time of the run (s)", fontsize=9)
    figure.savefig(path, dpi=DPI)
    return path
