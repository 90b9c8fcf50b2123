"""Prediction of recorded tendon angles on the simulated robot, and the fit of its parameters."""

from __future__ import annotations

import argparse
import hashlib
import os
import pickle
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.config import ConfigError, load
from slot_core.progress import ProgressLine
from slot_core.refusal import DivergenceError
from slot_lab.bags.bag import BagError
from slot_lab.calibration.experiments import PredictionError
from slot_lab.calibration.fit import FitError
from slot_lab.csv_table import TableError
from slot_lab.twin import leg_points, parameter_set, twin_plot
from slot_lab.twin.prediction import PredictedTrack, measured_track, predict, read_parts
from slot_lab.twin.recorded import read_recorded
from slot_lab.twin.settings import TwinSettings, read_twin
from slot_lab.twin.strides import Strides, find_strides, residuals, stride_errors
from slot_lab.twin.twin_fit import RunAll, fit_twin, parameter, places, serially
from slot_lab.verdict import Verdict
from slot_lab.workers import gather, workers

LAID_ON = 3  # numbers taken from the measurement in each window: x, y, heading
COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")

ERRORS = (
    BagError,
    ConfigError,
    DivergenceError,
    FitError,
    PredictionError,
    TableError,
    OSError,
)


def run(
    options: argparse.Namespace, progress: ProgressLine
) -> tuple[list[str], Verdict]:
    """Predict, fit if asked for, and write the files; returns the lines of the report."""
    settings, names = read_twin(), places([*filter(None, options.fit.split(","))])
    if options.set:
        parameter_set.place_of(options.set)
    parts = read_parts(options.scene, options.parameters)
    for name in names:
        parameter(parts, name)  # refused before anything is started
    start = parts.scene.parameters or load("robot")["parameters"]
    progress(f"reading {options.recording}")
    recorded = read_recorded(
        options.recording, options.namespace, options.angles, options.motion
    )
    strides = find_strides(recorded, settings, options.period)
    out = options.out or Path("results", "twin", recorded.name)
    out.mkdir(parents=True, exist_ok=True)
    lost = recorded.motion.left_out
    left_out = f", without {lost} readings that were lost" if lost else ""
    kind = (
        "measured"
        if recorded.angles.measured
        else "commands, through the model of the servo"
    )
    lines = [
        f"{recorded.name}: {strides.count} strides of {strides.period:.3g} s",
        f"tendon angles       {recorded.angles.source} ({kind})",
        f"motion              {recorded.motion.source}{left_out}",
        f"model               scene {options.scene}, parameters {start}",
        "",
    ]
    measured = measured_track(recorded.motion)
    predicting = partial(progress, "predicting the motion")
    predicted = predict(recorded, parts, settings, predicting)
    if names:
        with _runner(options) as run_all:
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
        seen = len(found.seen[0].level)
        content = parameter_set.record(recorded, parts, start, found, options.note)
        written = parameter_set.write(options.set, content) if options.set else None
        columns = {"before": found.held_out[0], "after": found.held_out[1]}
        lines += [
            f"fit to {seen} strides, judged on the {strides.count - seen} others",
            "",
        ]
        lines += [
            *parameter_set.error_lines(columns),
            "",
            *parameter_set.fit_lines(found),
        ]
        lines += ["", f"written: {os.path.relpath(written)}"] if written else []
        tracks = {
            "model": predicted,
            "fitted": predict(recorded, found.parts, settings, predicting),
        }
        parts = found.parts
        kept.forget()
        judged = strides.split(settings.held_out)[1]
        at_bound = found.estimate.at_bound(found.names)
        verdict = judge(tracks["fitted"], measured, judged, settings, at_bound)
    else:
        seen, tracks = None, {"model": predicted}
        lines += parameter_set.error_lines(
            {"model": stride_errors(predicted, measured, strides)}
        )
        verdict = judge(predicted, measured, strides, settings)
    title = f"{recorded.name}: predicted and measured motion"
    progress("drawing")
    twin_plot.draw(
        out / "twin.png", title, measured, tracks, strides=strides, seen=seen
    )
    told = partial(progress, "predicting the points of the legs")
    leg_points.write(recorded, parts, settings, out / "predicted.csv", told)
    (out / "summary.txt").write_text("\n".join([*lines, "", verdict.line]) + "\n")
    return [
        *lines,
        "",
        f"twin.png, predicted.csv and summary.txt are in {out}",
    ], verdict


def judge(
    predicted: PredictedTrack,
    measured: PredictedTrack,
    strides: Strides,
    settings: TwinSettings,
    at_bound: Sequence[str] = (),
) -> Verdict:
    """Verdict by the residuals of strides, those that a fit has not seen."""
    blocks = residuals(predicted, measured, strides, settings)
    chi_square = sum(float((block**2).sum()) for block in blocks)
    freedom = sum(block.size - LAID_ON for block in blocks)
    rms = np.sqrt(np.mean(np.vstack(blocks) ** 2, axis=0))
    worst = int(rms.argmax())
    largest = f"largest: {COORDINATES[worst]}, {rms[worst]:.3g} times the uncertainty"
    return Verdict(chi_square, freedom, at_bound, largest)


class _Trials:
    """Runs trials of a fit and keeps their residuals until it is done.

    They are in a folder of the directory that is the fit's own. fit: all on which the residuals
    depend besides the point.
    """

    def __init__(self, directory: Path, run_all: RunAll, fit: Any) -> None:
        self._run_all = run_all
        self._directory = directory / hashlib.sha256(pickle.dumps(fit)).hexdigest()[:16]
        self._directory.mkdir(parents=True, exist_ok=True)

    def __call__(
        self, call: Callable[[Array], Array], points: Sequence[Array]
    ) -> list[Array]:
        paths = [self._path(point) for point in points]
        todo = [n for n, path in enumerate(paths) if not path.exists()]
        for n, result in zip(todo, self._run_all(call, [points[n] for n in todo])):
            partial = paths[n].with_suffix(".part.npy")
            np.save(partial, result)
            partial.replace(paths[n])
        return [np.load(path) for path in paths]

    def forget(self) -> None:
        """Delete the results that were kept; those of other fits stay."""
        shutil.rmtree(self._directory)
        with suppress(OSError):  # not empty
            self._directory.parent.rmdir()

    def _path(self, point: Array) -> Path:
        name = hashlib.sha256(np.asarray(point).tobytes()).hexdigest()[:32]
        return self._directory / f"{name}.npy"


@contextmanager
def _runner(options: argparse.Namespace) -> Iterator[RunAll]:
    """Runs the trials: in this process, in local ones or on a cluster."""
    if options.workers == 1 and not options.scheduler:
        yield serially
        return
    with workers(options.scheduler, options.workers) as client:
        yield partial(gather, client)
