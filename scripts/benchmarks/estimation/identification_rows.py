"""Clocks found on 30 Hz data, and known changes of a robot recovered from noisy walks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from benchmarks.estimation.twin_walks import POSITION_NOISE, TrueWalk, walk
from benchmarks.harness import Check, Progress, Row, at_most
from slot_core.body_points import TORSO
from slot_core.robot import read_robot
from slot_lab.twin.prediction import read_parts
from slot_lab.twin.settings import read_twin
from slot_lab.twin.strides import find_strides
from slot_lab.twin.twin_fit import fit_twin, places
from slot_lab.validation.comparison import compare
from slot_lab.validation.recording import PointRecording, PointTrack

RATE = 30.0  # Hz, of the camera
CUT = 1.0  # s, of the walk that the camera misses at either end
FITTED = ("friction", "young_modulus", "tendon_offset")


@dataclass(frozen=True)
class IdentificationCase:
    """A change of the robot, and where a fit is to find it."""

    name: str
    changes: Mapping[str, Any]  # as in `ClosedLoop`
    place: str
    true: float
    goal: float  # largest error, absolute
    unit: str
    scale: float  # from SI to the unit


def cases() -> list[IdentificationCase]:
    """Changes of friction, stiffness and one tendon."""
    stiffness = 0.85 * read_robot().leg.young_modulus
    slack = [0.0005, 0.0, 0.0, 0.0]
    return [
        IdentificationCase(
            "friction .4 to .3", {"scene.floor.friction": [0.3] * 4}, "scene.floor.friction",
            0.3, 0.05 * 0.3, "", 1.0,
        ),
        IdentificationCase(
            "E -15 %", {"robot.leg.young_modulus": stiffness}, "robot.leg.young_modulus",
            stiffness, 0.05 * stiffness, "MPa", 1e-6,
        ),
        IdentificationCase(
            "one tendon +.5 mm", {"scene.tendons.slack": slack}, "scene.tendons.slack[0]",
            0.0005, 0.0001, "mm", 1e3,
        ),
    ]  # fmt: skip


def rows_and_checks(quick: bool, progress: Progress) -> tuple[list[Row], list[Check]]:
    """Rows of clocks and fits; `quick`: one fit of the friction alone to 14 s."""
    rows: list[Row] = []
    checks: list[Check] = []
    for case in cases()[:1] if quick else cases():
        progress(f"twin: {case.name}")
        true = walk(14.0 if quick else 20.0, case.changes)
        rows.append(fit_row(case, true, ("friction",) if quick else FITTED))
        checks += fit_checks(case, rows[-1])
    progress("clocks")
    clocks = [clock_row(true, points, 4 if quick else 20) for points in (1, 5)]
    worst = max(row["rms_ms"] for row in clocks)
    return rows + clocks, [at_most("clock aligned on 30 Hz data, RMS", worst, 2.0, "ms"), *checks]


def fit_row(case: IdentificationCase, true: TrueWalk, names: Sequence[str]) -> Row:
    """A fit to a noisy walk, with the error of the place after four unseen strides."""
    recorded, settings = true.recorded(np.random.default_rng(3)), read_twin()
    strides = find_strides(recorded, settings)
    found = fit_twin(
        recorded, read_parts("flat"), places(names), strides, settings, progress=lambda _: None
    )
    k = found.names.index(case.place)
    low, high = found.estimate.interval[k]
    before, after = (1e3 * errors.summary()["place"] for errors in found.held_out)
    return {
        "kind": "twin", "case": case.name, "fitted": list(found.names), "true": case.true,
        "found": float(found.estimate.values[k]), "low": float(low), "high": float(high),
        "strides": len(found.seen[0].level), "place_before_mm": before, "place_after_mm": after,
    }  # fmt: skip


def fit_checks(case: IdentificationCase, row: Row) -> list[Check]:
    """Error of the parameter, and of the strides that the fit has not seen."""
    off, ratio = abs(row["found"] - case.true), row["place_after_mm"] / row["place_before_mm"]
    return [
        at_most(f"twin, {case.name}: error", case.scale * off, case.scale * case.goal, case.unit),
        at_most(f"twin, {case.name}: held-out error of unfitted's", ratio, 1.0 / 3.0),
    ]


def clock_row(true: TrueWalk, points: int, seeds: int) -> Row:
    """Error of the clock's alignment for noisy points in a frame of their own."""
    names = [TORSO, "FL_base", "FL_third", "FL_two_thirds", "FL_tip"][:points]
    places_of = true.points()
    run = PointRecording("run", {n: PointTrack(true.t - true.t[0], places_of[n]) for n in names})
    errors = [_clock_errors(run, np.random.default_rng(seed)) for seed in range(seeds)]
    off = 1e3 * np.concatenate(errors)
    return {
        "kind": "clock", "points": points, "seeds": seeds, "seconds": float(np.ptp(true.t)),
        "rms_ms": float(np.sqrt(np.mean(off**2))), "max_ms": float(np.abs(off).max()),
    }  # fmt: skip


def _clock_errors(run: PointRecording, rng: np.random.Generator) -> np.ndarray:
    """Error of the time of every sample of a film with its own clock and frame, s."""
    drift, turn = rng.uniform(-5e-4, 5e-4), Rotation.random(random_state=rng)
    end = next(iter(run.points.values())).t[-1]
    t = np.arange(CUT + rng.uniform(0.0, 0.5), end - CUT, 1 / RATE)
    film = {}
    for name, track in run.points.items():
        place = CubicSpline(track.t, track.position)(t)
        noisy = place + rng.normal(scale=POSITION_NOISE, size=place.shape)
        film[name] = PointTrack((t - t[0]) * (1 + drift), turn.apply(noisy))
    clock = compare(run, PointRecording("film", film), frame="rigid").time
    return np.asarray(clock.apply(film[next(iter(film))].t) - t)
