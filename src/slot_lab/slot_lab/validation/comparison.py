"""Comparison of a run with a measurement: common points, aligned, and their errors.

With e_i = run_i - measured_i and the range W = max - min of the measurement:

    RMSE = sqrt(mean e^2),  MAE = mean |e|,  NRMSE = RMSE / W,  mean error = |mean e|,
    error = |mean e| / W,   accuracy = 1 - error.

The paper gives no formulas. These reproduce its table of the single leg to its digits: at the base
W = 5.20 mm / 5.87 % = 88.6 mm, and 2.23 mm / 88.6 mm = 2.51 %, accuracy 97.49 %; likewise at the
other points. Its accuracy thus counts the mean error only: an error that oscillates about zero is
100 % accurate, whatever its RMSE.

The intervals come from a moving block bootstrap (H. R. Kuensch, Ann. Statist. 17, 1989, 1217):
errors of neighbouring samples are alike, so blocks of them are drawn; range and alignment are kept.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from slot_core.arrays import Array
from slot_core.command_line import Tell, untold
from slot_core.robot import LEG_POINTS, LEGS
from slot_lab.validation.alignment import (
    FrameAlignment,
    Pair,
    TimeAlignment,
    align_frames,
    align_times,
)
from slot_lab.validation.recording import (
    ATTITUDE,
    LEAST_SAMPLES,
    PointRecording,
    PointTrack,
    RecordingError,
)
from slot_lab.verdict import Verdict

AXES = ("x", "y", "z")
CLOCK = 2  # free: offset and drift
FREE = {"rigid": 6, "level": 4, "none": 0}  # by frame
NAMES = ("rmse", "mae", "nrmse", "mean_error", "error", "accuracy")
DRAWS = 1000
LEVEL = 0.95
LEAST_BLOCKS = 3  # of a series; with fewer there is no interval


@dataclass(frozen=True)
class PointSeries:
    """A coordinate of a point at n times, in m or rad."""

    t: Array  # (n,) s, clock of the run
    run: Array  # (n,)
    measured: Array  # (n,)
    errors: Errors


@dataclass(frozen=True)
class Comparison:
    """Aligned coordinates of all common points."""

    time: TimeAlignment
    frame: FrameAlignment
    # by point and axis: x y z, roll pitch yaw
    series: Mapping[tuple[str, str], PointSeries]
    only: tuple[str, ...]  # points of one recording alone
    brief: tuple[str, ...] = ()  # seen too briefly or too late

    @property
    def points(self) -> list[str]:
        """Names of the points."""
        return list(dict.fromkeys(point for point, _ in self.series))


def compare(
    run: PointRecording,
    measured: PointRecording,
    *,
    frame: str = "level",
    offset: float | None = None,
    frame_time: float = np.inf,
    zero: bool = False,
    leg: str = "FL",
    block: float = 1.0,
    tell: Tell = untold,
) -> Comparison:
    """Align and compare.

    frame: what is free in the frames (alignment.py), by the first `frame_time` s. zero:
    each point's mean difference over that time is taken out, so that a marker may sit beside its
    point. offset: of the clocks, s, if known. leg: of points without one. block: of the bootstrap,
    s. Raises RecordingError if the recordings have no point or no time in common.
    """
    if any(
        f"{leg}_{name}" in r.points
        for r in (run, measured)
        for name in LEG_POINTS
    ):
        run, measured = _with_leg(run, leg), _with_leg(measured, leg)
    names = [name for name in run.points if name in measured.points]
    if not names:
        raise RecordingError(
            f"no common point: {run.name} has {', '.join(run.points)}; {measured.name} has"
            f" {', '.join(measured.points)}"
        )
    pairs = [(measured.points[name], run.points[name]) for name in names]
    clock = align_times(pairs, frame, offset)
    joined = {name: _joined(pair, clock) for name, pair in zip(names, pairs)}
    joined = {
        n: part for n, part in joined.items() if len(part[0]) >= LEAST_SAMPLES
    }
    if not joined:
        raise RecordingError(
            f"no point has {LEAST_SAMPLES} samples in the time of both recordings"
        )
    until = min(float(t[0]) for t, _, _ in joined.values()) + frame_time
    joined = {n: part for n, part in joined.items() if part[0][0] <= until}
    parts: tuple[list[Array], list[Array]] = [], []  # measured, run
    for t, mine, theirs in joined.values():
        for part, track in zip(parts, (theirs, mine)):
            place = track.position[t <= until]
            # with `zero` the turn from the motion alone
            part.append(place - place.mean(axis=0) if zero else place)
    aligned = align_frames(np.vstack(parts[0]), np.vstack(parts[1]), frame)
    series = {}
    for k, (name, (t, mine, theirs)) in enumerate(joined.items()):
        tell(k / len(joined))
        size = max(1, round(block / float(np.median(np.diff(t)))))
        for axis, (r, m) in _coordinates(mine, theirs, aligned).items():
            shift = np.mean((r - m)[t <= until]) if zero else 0.0
            found = errors(r, m + shift, size)
            series[name, axis] = PointSeries(t, r, m + shift, found)
    return Comparison(
        clock,
        aligned,
        series,
        only=tuple(sorted(set(run.points) ^ set(measured.points))),
        brief=tuple(sorted(set(names) - joined.keys())),
    )


def _coordinates(
    run: PointTrack, measured: PointTrack, aligned: FrameAlignment
) -> dict[str, tuple[Array, Array]]:
    """Coordinates of run and measurement by axis; attitudes if both have them."""
    place = aligned.apply(measured.position)
    columns = dict(zip(AXES, zip(run.position.T, place.T)))
    if run.rpy is None or measured.rpy is None:
        return columns
    turned = aligned.attitude(measured.rpy)
    turned[:, 2] += (
        2 * np.pi * np.rint(np.mean(run.rpy[:, 2] - turned[:, 2]) / (2 * np.pi))
    )
    return columns | dict(zip(ATTITUDE, zip(run.rpy.T, turned.T)))


def _with_leg(recording: PointRecording, leg: str) -> PointRecording:
    """The recording with the leg in the names of leg points."""
    return dataclasses.replace(
        recording,
        points={
            f"{leg}_{k}" if k in LEG_POINTS else k: v
            for k, v in recording.points.items()
        },
    )


def _joined(
    pair: Pair, clock: TimeAlignment
) -> tuple[Array, PointTrack, PointTrack]:
    """Times of the measurement within the run (n,), and both tracks there."""
    measured, run = pair
    t = clock.apply(measured.t)
    keep = (t >= run.t[0]) & (t <= run.t[-1])
    at = t[keep]
    rpy = None if run.rpy is None else CubicSpline(run.t, run.rpy)(at)
    theirs = None if measured.rpy is None else measured.rpy[keep]
    return (
        at,
        PointTrack(at, CubicSpline(run.t, run.position)(at), rpy),
        PointTrack(at, measured.position[keep], theirs),
    )


def paper_points(comparison: Comparison) -> dict[str, dict[str, str]]:
    """Leg points by leg ("" for a leg without name) and LEG_POINTS, if all are compared."""
    every = {
        leg: {name: f"{leg}_{name}".lstrip("_") for name in LEG_POINTS}
        for leg in ("", *LEGS)
    }
    return {
        leg: points
        for leg, points in every.items()
        if set(points.values()) <= set(comparison.points)
    }


def judge(
    comparison: Comparison, sigma: float, frame: str, zero: bool
) -> Verdict:
    """Verdict by the positions, whose standard uncertainty is `sigma` (m).

    frame: what is free in the frames. zero: whether each point's mean difference is taken
    out.
    """
    off = {
        key: (series.run - series.measured) / sigma
        for key, series in comparison.series.items()
        if key[1] in AXES
    }
    rms = {key: math.sqrt(float(np.mean(r**2))) for key, r in off.items()}
    point, axis = max(rms, key=lambda key: rms[key])
    fitted = CLOCK + FREE[frame] + (3 * len(comparison.points) if zero else 0)
    return Verdict(
        sum(float(r @ r) for r in off.values()),
        sum(len(r) for r in off.values()) - fitted,
        largest=f"largest: {point} {axis}, {rms[point, axis]:.3g} times the uncertainty",
    )


@dataclass(frozen=True)
class Errors:
    """Metrics of one coordinate by name, each with its 95 % interval (NaN: series too short).

    rmse, mae and mean_error in the unit of the series, the others as parts of one.
    """

    value: dict[str, float]
    interval: dict[str, tuple[float, float]]
    span: float  # W, range of the measurement
    samples: int


def errors(run: Array, measured: Array, block: int) -> Errors:
    """Errors of series (n,) with blocks of `block` samples; raises ValueError for other shapes."""
    if run.shape != measured.shape or run.ndim != 1 or not len(run):
        raise ValueError(
            f"shapes differ or are empty: {run.shape} and {measured.shape}"
        )
    off, span = run - measured, float(np.ptp(measured))
    value = metrics(_parts(off[None])[:, 0].tolist(), span)
    interval = dict.fromkeys(NAMES, (math.nan, math.nan))
    if len(off) >= LEAST_BLOCKS * block:
        drawn = _parts(_drawn(off, block, np.random.default_rng(0)))
        ends = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=1)
        crosses_zero = ends[0, 2] < 0.0 < ends[1, 2]
        ends[:, 2] = np.sort(np.abs(ends[:, 2]))
        if crosses_zero:
            ends[0, 2] = 0.0
        low, high = (metrics(end, span) for end in ends.tolist())
        interval = {
            name: (min(low[name], high[name]), max(low[name], high[name]))
            for name in NAMES
        }
    return Errors(value, interval, span, len(off))


def metrics(parts: Sequence[float], span: float) -> dict[str, float]:
    """Metrics by name from RMSE, MAE, mean error and range; NaN where the range is zero."""
    rmse, mae, mean = map(abs, parts)
    width = span if span > 0 else math.nan
    values = (rmse, mae, rmse / width, mean, mean / width, 1.0 - mean / width)
    return dict(zip(NAMES, values))


def _parts(off: Array) -> Array:
    """(3, m) RMSE, MAE and mean error (with sign) of rows of errors (m, n)."""
    return np.array(
        [
            np.sqrt(np.mean(off**2, axis=1)),
            np.mean(np.abs(off), axis=1),
            off.mean(axis=1),
        ]
    )


def _drawn(off: Array, block: int, rng: np.random.Generator) -> Array:
    """(DRAWS, n) errors put together from blocks that begin anywhere."""
    count = math.ceil(len(off) / block)
    starts = rng.integers(0, len(off) - block + 1, size=(DRAWS, count))
    index = (starts[:, :, None] + np.arange(block)).reshape(DRAWS, -1)[
        :, : len(off)
    ]
    return np.asarray(off[index])
