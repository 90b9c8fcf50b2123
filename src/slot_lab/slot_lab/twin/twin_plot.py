"""Plots of the twin: predicted against measured motion, and the growth of the errors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slot_core.drawing import palette
from slot_lab.plot_file import write_plot
from slot_lab.twin.prediction import PredictedTrack
from slot_lab.twin.strides import (
    PITCH,
    ROLL,
    YAW,
    Strides,
    Z,
    error_growth,
    placed,
    stride_errors,
)

DPI = 100
COLOURS = (palette.SECONDARY, palette.TRUE)


def draw(
    path: Path,
    title: str,
    measured: PredictedTrack,
    predictions: Mapping[str, PredictedTrack],
    *,
    strides: Strides,
    seen: int | None,
) -> None:
    """Write the figure of predictions by name (at most two) as PNG; raises OSError.

    seen: number of strides that a fit has seen.
    """
    figure = Figure(figsize=(9.0, 12.0), dpi=DPI, layout="constrained")
    figure.suptitle(title, fontsize=12, fontweight="bold")
    path_of, forward, turned, growth, heading, height, roll, pitch = figure.subplots(
        4, 2
    ).ravel()
    laid = {
        name: placed(track, measured, strides) for name, track in predictions.items()
    }
    keep = (measured.t >= strides.edges[0]) & (measured.t <= strides.edges[-1])
    inside = PredictedTrack(
        measured.t[keep], measured.position[keep], measured.rpy[keep]
    )
    _path(path_of, inside, laid)
    for ax, column in ((forward, 0), (turned, 2)):
        _of_strides(ax, column, measured, predictions, strides)
        if seen is not None:
            ax.axvspan(seen + 0.5, strides.count, color=palette.SHADE, zorder=0)
            ax.text(seen + 0.7, ax.get_ylim()[0], "held out", fontsize=8, va="bottom")
    _growth(growth, measured, predictions, strides)
    columns = ((heading, YAW, "heading (deg)"), (height, Z, "height of base_link (mm)"))
    for ax, column, label in (
        *columns,
        (roll, ROLL, "roll (deg)"),
        (pitch, PITCH, "pitch (deg)"),
    ):
        _over_time(ax, inside, laid, column, label)
    write_plot(figure, path, DPI)


def _path(
    ax: Axes, measured: PredictedTrack, predictions: Mapping[str, PredictedTrack]
) -> None:
    ax.plot(
        *1e3 * measured.position[:, :2].T, color=palette.INK, lw=1, label="measured"
    )
    for (name, track), colour in zip(predictions.items(), COLOURS):
        ax.plot(*1e3 * track.position[:, :2].T, color=colour, lw=1, label=name)
    _finish(ax, "path, laid on the first stride (scales differ)", "x (mm)", "y (mm)")
    ax.legend(fontsize=8, frameon=False)


def _of_strides(
    ax: Axes,
    column: int,
    measured: PredictedTrack,
    predictions: Mapping[str, PredictedTrack],
    strides: Strides,
) -> None:
    """Displacement forward (column 0) or turn (column 2) of each stride."""
    factor = 1e3 if column == 0 else 180.0 / np.pi
    for (name, track), colour in zip(predictions.items(), COLOURS):
        found = stride_errors(track, measured, strides)
        number = np.arange(1, len(found.measured) + 1)
        ax.plot(
            number, factor * found.predicted[:, column], ".-", color=colour, label=name
        )
    ax.plot(number, factor * found.measured[:, column], "o", color=palette.INK, ms=4)
    kind = "forward displacement" if column == 0 else "turn"
    _finish(ax, f"{kind} of each stride", "stride", "mm" if column == 0 else "deg")


def _growth(
    ax: Axes,
    measured: PredictedTrack,
    predictions: Mapping[str, PredictedTrack],
    strides: Strides,
) -> None:
    for (name, track), colour in zip(predictions.items(), COLOURS):
        ahead, place, turned = error_growth(track, measured, strides).T
        ax.plot(ahead, 1e3 * place, color=colour, label=f"{name}: place (mm)")
        ax.plot(
            ahead,
            np.degrees(turned),
            "--",
            color=colour,
            label=f"{name}: heading (deg)",
        )
    ax.set_yscale("log")
    _finish(ax, "growth of the errors, RMS", "strides predicted", "")
    ax.legend(fontsize=8, frameon=False)


def _over_time(
    ax: Axes,
    measured: PredictedTrack,
    predictions: Mapping[str, PredictedTrack],
    column: int,
    label: str,
) -> None:
    scale = 1e3 if column < 3 else 180.0 / np.pi
    place = scale * measured.columns[:, column]
    ax.plot(measured.t - measured.t[0], place, ".", ms=2, color=palette.INK)
    for track, colour in zip(predictions.values(), COLOURS):
        ax.plot(
            track.t - measured.t[0],
            scale * track.columns[:, column],
            color=colour,
            lw=1,
        )
    _finish(ax, label, "time (s)", "")


def _finish(ax: Axes, title: str, x_label: str, y_label: str) -> None:
    ax.set_title(title, fontsize=10, loc="left")
    ax.set_xlabel(x_label, fontsize=9)
    ax.set_ylabel(y_label, fontsize=9)
    ax.tick_params(labelsize=8)
    ax.grid(color=palette.SHADE)
