"""Comparison of a run with a measurement: common points, aligned, with their errors."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from slot_core.arrays import Array
from slot_core.progress import Tell, untold
from slot_core.robot import LEG_POINTS, TORSO
from slot_lab.validation.error_metrics import Errors, errors
from slot_lab.validation.frame_alignment import FrameAlignment, align_frames
from slot_lab.validation.recording import (
    ATTITUDE,
    LEAST_SAMPLES,
    PointRecording,
    PointTrack,
    RecordingError,
)
from slot_lab.validation.time_alignment import Pair, TimeAlignment, align_times

AXES = ("x", "y", "z")


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
    series: Mapping[
        tuple[str, str], PointSeries
    ]  # by point and axis: x y z, roll pitch yaw
    only: tuple[str, ...]  # points of one recording alone
    brief: tuple[
        str, ...
    ] = ()  # with too few samples in the time of both, or seen too late

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

    frame: what is free in the frames (frame_alignment.py), by the first `frame_time` s. zero:
    each point's mean difference over that time is taken out, so that a marker may sit beside its
    point. offset: of the clocks, s, if known. leg: of points without one. block: of the bootstrap,
    s. Raises RecordingError if the recordings have no point or no time in common.
    """
    if any(f"{leg}_{name}" in r.points for r in (run, measured) for name in LEG_POINTS):
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
        name: part for name, part in joined.items() if len(part[0]) >= LEAST_SAMPLES
    }
    if not joined:
        raise RecordingError(
            f"no point has {LEAST_SAMPLES} samples in the time of both recordings"
        )
    until = min(float(t[0]) for t, _, _ in joined.values()) + frame_time
    joined = {name: part for name, part in joined.items() if part[0][0] <= until}
    parts = [
        (p.position[p.t <= until], r.position[r.t <= until])
        for _, r, p in joined.values()
    ]
    if zero:  # the turn from the motion alone
        parts = [
            (theirs - theirs.mean(axis=0), mine - mine.mean(axis=0))
            for theirs, mine in parts
        ]
    aligned = align_frames(
        np.vstack([theirs for theirs, _ in parts]),
        np.vstack([mine for _, mine in parts]),
        frame,
    )
    series = {}
    for k, (name, (t, mine, theirs)) in enumerate(joined.items()):
        tell(k / len(joined))
        size = max(1, round(block / float(np.median(np.diff(t)))))
        for axis, (r, m) in _coordinates(mine, theirs, aligned).items():
            shift = np.mean((r - m)[t <= until]) if zero else 0.0
            series[name, axis] = PointSeries(
                t, r, m + shift, errors(r, m + shift, size)
            )
    only = tuple(sorted(set(run.points) ^ set(measured.points)))
    return Comparison(
        clock, aligned, series, only, tuple(sorted(set(names) - joined.keys()))
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
    points = {
        f"{leg}_{k}" if k in LEG_POINTS else k: v for k, v in recording.points.items()
    }
    return dataclasses.replace(recording, points=points)


def _joined(pair: Pair, clock: TimeAlignment) -> tuple[Array, PointTrack, PointTrack]:
    """Times of the measurement within the run (n,), and both tracks there."""
    measured, run = pair
    t = clock.apply(measured.t)
    keep = (t >= run.t[0]) & (t <= run.t[-1])
    at = t[keep]
    rpy = None if run.rpy is None else CubicSpline(run.t, run.rpy)(at)
    theirs = None if measured.rpy is None else measured.rpy[keep]
    place = CubicSpline(run.t, run.position)(at)
    return (
        at,
        PointTrack(at, place, rpy),
        PointTrack(at, measured.position[keep], theirs),
    )


def paper_points(comparison: Comparison) -> dict[str, dict[str, str]]:
    """Leg points by leg ("" for a leg without name) and LEG_POINTS, where all four are compared."""
    found: dict[str, dict[str, str]] = {}
    for point in comparison.points:
        if point != TORSO:
            leg, _, name = (
                point.partition("_") if point not in LEG_POINTS else ("", "", point)
            )
            found.setdefault(leg, {})[name] = point
    return {
        leg: points for leg, points in found.items() if set(points) == set(LEG_POINTS)
    }
