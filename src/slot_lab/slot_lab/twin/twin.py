"""Prediction of recorded tendon angles on the simulated robot, and the fit of its parameters."""

import argparse
import hashlib
import os
import pickle
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slot_core.arrays import Array
from slot_core.command_line import ProgressLine
from slot_core.config import load
from slot_core.drawing import palette
from slot_lab.bags.recorded_walk import TorsoTrack
from slot_lab.calibration.fit import RunAll
from slot_lab.desk_command import Outcome, write_plot
from slot_lab.twin.prediction import predict, read_parts, write_predicted_points
from slot_lab.twin.strides import (
    PITCH,
    ROLL,
    YAW,
    Strides,
    TwinSettings,
    Z,
    error_growth,
    find_strides,
    placed,
    read_recorded,
    read_twin,
    residuals,
    stride_errors,
)
from slot_lab.twin.twin_fit import (
    error_lines,
    fit_lines,
    fit_twin,
    parameter,
    place_of,
    places,
    record_fit,
    write_set,
)
from slot_lab.verdict import Verdict
from slot_lab.workers import mapper

ALIGNED = 3  # numbers taken from the measurement in each window: x, y, heading
COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")
DPI = 100
COLOURS = (palette.SECONDARY, palette.TRUE)
OVER_TIME = {
    YAW: "heading (deg)",
    Z: "height of base_link (mm)",
    ROLL: "roll (deg)",
    PITCH: "pitch (deg)",
}
"""Labels of the panels over time, by column of a pose."""
Aligned = tuple[Array, Array]  # times (n,), s, and poses (n, 6)


def run(options: argparse.Namespace, progress: ProgressLine) -> Outcome:
    """Predict, fit if asked for, and write the files; returns the report and exit code.

    Raises BagError, ConfigError, DivergenceError, FitError, PredictionError, TableError,
    OSError.
    """
    settings, names = (
        read_twin(),
        places([*filter(None, options.fit.split(","))]),
    )
    if options.set:
        place_of(options.set)
    parts = read_parts(options.scene, options.parameters)
    for name in names:
        parameter(parts, name)  # refused before anything is started
    start = parts.scene.parameters or load("robot")["parameters"]
    progress(f"reading {options.recording}")
    recorded = read_recorded(
        options.recording,
        options.namespace,
        options.angles,
        options.motion,
        dict(options.remap),
    )
    strides = find_strides(recorded, settings, options.period)
    out = options.out or Path("results", "twin", recorded.name)
    out.mkdir(parents=True, exist_ok=True)
    angles, measured = recorded.angles, recorded.motion
    lost = measured.left_out
    left_out = f", without {lost} readings that were lost" if lost else ""
    kind = (
        "measured"
        if angles.measured
        else "commands, through the model of the servo"
    )
    lines = [
        f"{recorded.name}: {strides.count} strides of {strides.period:.3g} s",
        f"tendon angles       {angles.source} ({kind})",
        f"motion              {measured.source}{left_out}",
        f"model               scene {options.scene}, parameters {start}",
        "",
    ]
    predicting = partial(progress, "predicting the motion")
    tracks = {"model": predict(recorded, parts, settings, predicting)}
    if names:
        with mapper(options.scheduler, options.workers) as run_all:
            trial = (recorded, strides, parts, names, settings, options.starts)
            kept = _Trials(out / "trials", run_all, trial)
            found = fit_twin(
                recorded,
                parts,
                names,
                strides,
                settings,
                run_all=kept,
                starts=options.starts,
                say=progress.say,
                tell=progress,
            )
        seen, judged = strides.split(settings.held_out)
        lines += [
            f"fit to {seen.count} strides, judged on the {judged.count} others",
            "",
            *error_lines(dict(zip(("before", "after"), found.held_out))),
            "",
            *fit_lines(found),
        ]
        if options.set:
            content = record_fit(recorded, parts, start, found, options.note)
            written = write_set(options.set, content)
            lines += ["", f"written: {os.path.relpath(written)}"]
        parts = found.parts
        tracks["fitted"] = predict(recorded, parts, settings, predicting)
        kept.forget()
        verdict = judge(
            tracks["fitted"],
            measured,
            judged,
            settings,
            found.estimate.at_bound(found.names),
        )
    else:
        seen = None
        lines += error_lines(
            {"model": stride_errors(tracks["model"], measured, strides)}
        )
        verdict = judge(tracks["model"], measured, strides, settings)
    progress("drawing")
    draw(
        out / "twin.png",
        f"{recorded.name}: predicted and measured motion",
        measured,
        tracks,
        strides=strides,
        seen=seen.count if seen else None,
    )
    write_predicted_points(
        recorded,
        parts,
        settings,
        out / "predicted.csv",
        partial(progress, "predicting the points of the legs"),
    )
    (out / "summary.txt").write_text(
        "\n".join([*lines, "", verdict.line]) + "\n"
    )
    return [
        *lines,
        "",
        f"twin.png, predicted.csv and summary.txt are in {out}",
        verdict.line,
    ], verdict.code


def judge(
    predicted: TorsoTrack,
    measured: TorsoTrack,
    strides: Strides,
    settings: TwinSettings,
    at_bound: Sequence[str] = (),
) -> Verdict:
    """Verdict by the residuals of strides that a fit has not seen."""
    blocks = residuals(predicted, measured, strides, settings)
    chi_square = sum(float((block**2).sum()) for block in blocks)
    freedom = sum(block.size - ALIGNED for block in blocks)
    rms = np.sqrt(np.mean(np.vstack(blocks) ** 2, axis=0))
    most, worst = max(zip(rms, COORDINATES))
    largest = f"largest: {worst}, {most:.3g} times the uncertainty"
    return Verdict(chi_square, freedom, at_bound, largest)


class _Trials:
    """Runs trials of a fit and keeps their residuals until it is done.

    Each fit has a folder in the directory. fit: all on which the residuals depend besides
    the point.
    """

    def __init__(self, directory: Path, run_all: RunAll, fit: Any) -> None:
        self._run_all = run_all
        self._directory = (
            directory / hashlib.sha256(pickle.dumps(fit)).hexdigest()[:16]
        )
        self._directory.mkdir(parents=True, exist_ok=True)

    def __call__(
        self, call: Callable[[Array], Array], points: Sequence[Array]
    ) -> list[Array]:
        paths = [self._path(point) for point in points]
        todo = [n for n, path in enumerate(paths) if not path.exists()]
        for n, result in zip(
            todo, self._run_all(call, [points[n] for n in todo])
        ):
            partial = paths[n].with_suffix(".part.npy")
            np.save(partial, result)
            partial.replace(paths[n])
        return [np.load(path) for path in paths]

    def forget(self) -> None:
        """Delete the results of this fit; other fits keep theirs."""
        shutil.rmtree(self._directory)
        with suppress(OSError):  # not empty
            self._directory.parent.rmdir()

    def _path(self, point: Array) -> Path:
        name = hashlib.sha256(np.asarray(point).tobytes()).hexdigest()[:32]
        return self._directory / f"{name}.npy"


def draw(
    path: Path,
    title: str,
    measured: TorsoTrack,
    predictions: Mapping[str, TorsoTrack],
    *,
    strides: Strides,
    seen: int | None,
) -> None:
    """Write the figure of predictions by name (at most two) as PNG; raises OSError.

    seen: number of strides that a fit has seen.
    """
    figure = Figure(figsize=(9.0, 12.0), dpi=DPI, layout="constrained")
    figure.suptitle(title, fontsize=12, fontweight="bold")
    path_of, forward, turned, growth, *over_time = figure.subplots(4, 2).ravel()
    aligned = {n: placed(p, measured, strides) for n, p in predictions.items()}
    inside = measured.between(strides.edges[0], strides.edges[-1])
    _path(path_of, inside, aligned)
    for ax, column in ((forward, 0), (turned, 2)):
        _of_strides(ax, column, measured, predictions, strides)
        if seen is not None:
            ax.axvspan(seen + 0.5, strides.count, color=palette.SHADE, zorder=0)
            ax.text(
                seen + 0.7,
                ax.get_ylim()[0],
                "held out",
                fontsize=8,
                va="bottom",
            )
    _growth(growth, measured, predictions, strides)
    for ax, (column, label) in zip(over_time, OVER_TIME.items()):
        _over_time(ax, inside, aligned, column, label)
    write_plot(figure, path, DPI)


def _path(
    ax: Axes, measured: TorsoTrack, aligned: Mapping[str, Aligned]
) -> None:
    x, y = 1e3 * measured.position[:, :2].T
    ax.plot(x, y, color=palette.INK, lw=1, label="measured")
    for (name, (_, pose)), colour in zip(aligned.items(), COLOURS):
        x, y = 1e3 * pose[:, :2].T
        ax.plot(x, y, color=colour, lw=1, label=name)
    _finish(
        ax,
        "path, aligned with the first stride (scales differ)",
        "x (mm)",
        "y (mm)",
    )
    ax.legend(fontsize=8, frameon=False)


def _of_strides(
    ax: Axes,
    column: int,
    measured: TorsoTrack,
    predictions: Mapping[str, TorsoTrack],
    strides: Strides,
) -> None:
    """Displacement forward (column 0) or turn (column 2) of each stride."""
    kind, unit, factor = (
        ("forward displacement", "mm", 1e3)
        if column == 0
        else ("turn", "deg", 180.0 / np.pi)
    )
    for (name, track), colour in zip(predictions.items(), COLOURS):
        found = stride_errors(track, measured, strides)
        number = np.arange(1, len(found.measured) + 1)
        ax.plot(
            number,
            factor * found.predicted[:, column],
            ".-",
            color=colour,
            label=name,
        )
    ax.plot(
        number, factor * found.measured[:, column], "o", color=palette.INK, ms=4
    )
    _finish(ax, f"{kind} of each stride", "stride", unit)


def _growth(
    ax: Axes,
    measured: TorsoTrack,
    predictions: Mapping[str, TorsoTrack],
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
    measured: TorsoTrack,
    aligned: Mapping[str, Aligned],
    column: int,
    label: str,
) -> None:
    scale, begin = (1e3 if column < 3 else 180.0 / np.pi), measured.t[0]
    ax.plot(
        measured.t - begin,
        scale * measured.pose[:, column],
        ".",
        ms=2,
        color=palette.INK,
    )
    for (t, pose), colour in zip(aligned.values(), COLOURS):
        ax.plot(t - begin, scale * pose[:, column], color=colour, lw=1)
    _finish(ax, label, "time (s)", "")


def _finish(ax: Axes, title: str, x_label: str, y_label: str) -> None:
    ax.set_title(title, fontsize=10, loc="left")
    ax.set_xlabel(x_label, fontsize=9)
    ax.set_ylabel(y_label, fontsize=9)
    ax.tick_params(labelsize=8)
    ax.grid(color=palette.SHADE)
