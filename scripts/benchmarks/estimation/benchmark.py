"""Error of the state at the time when the MPC uses it, with poor odometry, and of vision.

Sensor streams are those of walks in simulation, with the sensors' noise of config/scene/flat.yaml;
delays, losses and jumps are put on them. Three ways are compared: the authors' finite differences
with zero angular rates, the filter's state at the stamp of the odometry, and the state predicted
with the IMU to its newest sample. Errors are RMS over all axes, at the arrival of the odometry.
Vision, on rendered images: `vision_rows.py`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.estimation import measured_streams as measured
from benchmarks.estimation import methods, plots, vision_rows
from benchmarks.estimation.measured_streams import (
    PERIOD,
    WARM_UP,
    Arrival,
    Slam,
    Streams,
)
from benchmarks.harness import Check, Progress, Row, at_least, at_most, cpu_time
from slot_core.arrays import Array
from slot_core.clock import SECOND
from slot_core.estimation.estimate import Estimate
from slot_core.estimation.inertial_filter import EstimatorSettings
from slot_core.estimation.state_estimator import StateEstimator, read_estimator
from slot_core.geometry import wrapped
from slot_core.simulation.readings import ImuReading, OdometryReading

DELAYS = ((0.0, 0.0), (0.02, 0.01), (0.05, 0.02), (0.08, 0.02))  # s, with jitter
ERRORS = {"roll_pitch_mrad": (0, 2), "position_mm": (3, 6), "rate_mrad_s": (6, 9)}
ERRORS |= {"velocity_mm_s": (9, 12)}
ESTIMATED, RATE = (0, 1, 2, 3, 4, 5, 9, 10, 11), (6, 7, 8)  # of the state
PASSES, PLAIN_STEPS = 7, 1000  # over the walk; steps of a filter in NumPy after each
# CPU of the estimator over that of such a step: 50 and 150 us where it takes some 95 us.
IMU_RATIO, ODOMETRY_RATIO = 0.5, 1.6
WITHIN = (
    0.9  # share of the ticks; 0.95 is expected, and the ticks of a walk are correlated
)
Method = Callable[..., Iterable[methods.Use]]


def run(quick: bool, out: Path, progress: Progress) -> tuple[list[Row], list[Check]]:
    """Measure; `quick`: one walk of 10 s in place of twenty of 20 s, eight in closed loop."""
    seeds, duration = (range(1), 10.0) if quick else (range(20), 20.0)
    settings = read_estimator()
    progress(f"{len(seeds)} walks of {duration:g} s")
    walks = [measured.record(seed, duration) for seed in seeds]
    rows: list[Row] = []
    for delay, jitter in DELAYS:
        progress(f"delay {1e3 * delay:g} ms")
        rows += method_rows(walks, Slam(delay, jitter), settings, kind="delay")
    others = {
        "losses": Slam(0.05, 0.02, loss=0.2),
        "jumps": Slam(0.05, 0.02, jumps=(3.0, 4.0, 5.0)),
        "one second lost": Slam(0.05, 0.02, gap=(5.0, 6.0)),
    }
    for name, slam in others.items():
        progress(name)
        rows += method_rows(walks, slam, settings, kind=name)
    lost = [
        error_after_loss(walk, others["one second lost"], settings) for walk in walks
    ]
    rows.append(nees_row(walks, settings))
    rows += [
        cpu_row(walks[0], settings),
        *closed_loop_rows(range(8 if quick else 20), progress),
    ]
    rows += vision_rows.rows(quick, progress)
    plots.draw(rows, out / "estimation.png")
    return rows, checks(rows, np.array(lost))


def method_rows(
    walks: list[Streams], slam: Slam, settings: EstimatorSettings, kind: str
) -> list[Row]:
    """RMS errors of the three ways over the walks."""
    ways: dict[str, Method] = {
        "finite differences": methods.finite_differences,
        "without prediction": lambda a: methods.without_prediction(a, settings),
        "predicted": lambda a: methods.predicted(a, settings),
    }
    rows: list[Row] = []
    for name, way in ways.items():
        errors = np.vstack([errors_at_use(walk, slam, way) for walk in walks])
        rms = {
            key: 1e3 * float(np.sqrt(np.mean(errors[:, slice(*part)] ** 2)))
            for key, part in ERRORS.items()
        }
        place = {"kind": kind, "method": name, "delay_ms": 1e3 * slam.delay}
        rows.append(
            {**place, "jitter_ms": 1e3 * slam.jitter, "ticks": len(errors), **rms}
        )
    return rows


def errors_at_use(walk: Streams, slam: Slam, way: Method) -> Array:
    """Errors (n, 12) of the states when they are used, after the warm-up."""
    arrivals = slam.arrivals(walk, np.random.default_rng(0))
    start = walk.stamps[0] + WARM_UP * SECOND
    used = [(at, state) for at, state in way(arrivals) if start < at <= walk.end]
    return np.array([difference(state, walk.true_state(at)) for at, state in used])


def difference(state: Array, true: Array) -> Array:
    """Error (12,) of a state, angles wrapped."""
    error = state - true
    error[:3] = wrapped(error[:3])
    return error


def error_after_loss(walk: Streams, slam: Slam, settings: EstimatorSettings) -> Array:
    """Largest error of [position, velocity] before the odometry returns, m and m/s."""
    arrivals = slam.arrivals(walk, np.random.default_rng(0))
    end = walk.stamps[0] + slam.gap[1] * SECOND
    used = [(t, s) for t, s in methods.predicted(arrivals, settings) if t <= end]
    error = difference(used[-1][1], walk.true_state(used[-1][0]))
    return np.array([np.abs(error[3:6]).max(), np.abs(error[9:12]).max()])


def nees_row(walks: list[Streams], settings: EstimatorSettings) -> Row:
    """Normalised error squared of the predicted states, by tick its mean over the walks.

    Of attitude, position and velocity, which the filter estimates: if it is consistent, 95 % of the
    ticks are within the bounds of their chi-square distribution (Bar-Shalom, Li, Kirubarajan,
    Estimation, 2001, 5.4). The error of the angular velocity comes from impacts since the last
    sample and is not Gaussian; its mean over all ticks, of three, is a figure without bounds.
    """
    slam, first, by_walk = Slam(0.05, 0.02), round(WARM_UP / PERIOD), []
    for walk in walks:
        arrivals = slam.arrivals(walk, np.random.default_rng(0))
        found = [
            e for _, e in methods.estimates(arrivals, settings) if e.time <= walk.end
        ]
        errors = [
            (difference(e.state, walk.true_state(e.time)), e) for e in found[first:]
        ]
        by_walk.append([(nees(x, e, ESTIMATED), nees(x, e, RATE)) for x, e in errors])
    ticks = min(map(len, by_walk))
    estimated, rate = np.mean([walk[:ticks] for walk in by_walk], axis=0).T
    low, high = stats.chi2.ppf([0.025, 0.975], len(ESTIMATED) * len(walks)) / len(walks)
    within = np.mean((low <= estimated) & (estimated <= high))
    row = {
        "kind": "nees",
        "mean": estimated.mean(),
        "low": low,
        "high": high,
        "within": within,
    }
    return row | {"ticks": ticks, "rate_mean": rate.mean()}


def nees(error: Array, estimate: Estimate, part: Sequence[int]) -> float:
    """Normalised error squared of some states."""
    some = error[list(part)]
    return float(some @ np.linalg.solve(estimate.covariance[np.ix_(part, part)], some))


def cpu_row(walk: Streams, settings: EstimatorSettings) -> Row:
    """CPU time of one IMU sample and of one odometry reading delayed by 50 ms.

    Over that of one step of the filter in NumPy and SciPy: medians of passes over the walk, each
    followed by such steps.
    """
    arrivals = [*Slam(0.05).arrivals(walk, np.random.default_rng(0))]
    passes = np.empty((PASSES, 3))
    for figures in passes:
        figures[:2] = cpu_times(arrivals, settings)
        figures[2] = cpu_time(methods.plain_step, 1, PLAIN_STEPS).median
    microseconds, ratios = (
        1e6 * np.median(passes, axis=0),
        passes[:, :2] / passes[:, 2:],
    )
    return {
        "kind": "cpu",
        **dict(zip(("imu_us", "odometry_us", "plain_step_us"), microseconds)),
        **dict(zip(("imu_ratio", "odometry_ratio"), np.median(ratios, axis=0))),
    }


def cpu_times(
    arrivals: Sequence[Arrival], settings: EstimatorSettings
) -> tuple[float, float]:
    """Median CPU time, s, of taking an IMU sample and an odometry reading."""
    times: dict[type, list[float]] = {ImuReading: [], OdometryReading: []}
    estimator = StateEstimator(settings)
    for _, r in arrivals:
        start = time.process_time()
        methods.add_to(estimator, r)
        while estimator.poll() is not None:
            pass
        times[type(r)].append(time.process_time() - start)
    imu, odometry = (float(np.median(each)) for each in times.values())
    return imu, odometry


def closed_loop_rows(seeds: Sequence[int], progress: Progress) -> list[Row]:
    """Errors of the walk with late odometry: velocity, drift to the side, tilt over 8 s.

    Means over the seeds; the drift alone varies by 15 % from seed to seed.
    """
    rows: list[Row] = []
    for delay in (0.01, 0.08):
        progress(f"{len(seeds)} walks with odometry {1e3 * delay:g} ms late")
        row = {"kind": "closed loop", "delay_ms": 1e3 * delay, "seeds": len(seeds)}
        late = {"scene.sensors.odometry.delay": delay}
        found = [walk_figures(seed, late) for seed in seeds]
        rows.append(
            row | {key: np.mean([each[key] for each in found]) for key in found[0]}
        )
    return rows


def walk_figures(seed: int, changes: Mapping[str, Any]) -> dict[str, float]:
    """Velocity, drift to the side, and RMS of roll and pitch of a walk."""
    states, figures = measured.walked(
        measured.RecordingPlant, seed, 10.0, changes
    ).motion()
    return figures | {"tilt_mrad": 1e3 * np.sqrt(np.mean(states[:, 0:2] ** 2))}


def checks(rows: list[Row], lost: Array) -> list[Check]:
    """Figures that have a goal."""

    def row(**wanted: Any) -> Row:
        (found,) = [r for r in rows if wanted.items() <= r.items()]
        return found

    ours = row(kind="delay", method="predicted", delay_ms=50.0)
    authors = row(kind="delay", method="finite differences", delay_ms=50.0)
    near, far = (row(kind="closed loop", delay_ms=delay) for delay in (10.0, 80.0))
    nees, cpu = row(kind="nees"), row(kind="cpu")
    faster = authors["velocity_mm_s"] / ours["velocity_mm_s"]
    return [
        at_most("position, 50 ms late", ours["position_mm"], 2.0, "mm"),
        at_most("velocity, 50 ms late", ours["velocity_mm_s"], 10.0, "mm/s"),
        at_most("roll and pitch, 50 ms late", ours["roll_pitch_mrad"], 5.0, "mrad"),
        at_least("velocity error of finite differences", faster, 3),
        at_most(
            "position after 1 s without odometry", 1e3 * lost[:, 0].max(), 50.0, "mm"
        ),
        at_most(
            "velocity after 1 s without odometry", 1e3 * lost[:, 1].max(), 50.0, "mm/s"
        ),
        at_least("mean NEES", nees["mean"], nees["low"]),
        at_most("mean NEES", nees["mean"], nees["high"]),
        at_least(
            "NEES within its 95 % bounds: share of the ticks", nees["within"], WITHIN
        ),
        at_most("v_x, 80 ms late", abs(far["v_x_mm_s"] / near["v_x_mm_s"] - 1.0), 0.05),
        *[
            at_most(f"{name} added by 80 ms", far[name] / near[name] - 1.0, 0.05)
            for name in ("lateral_mm", "tilt_mrad")
        ],
        at_most("CPU of an IMU step over one in NumPy", cpu["imu_ratio"], IMU_RATIO),
        at_most(
            "CPU of an odometry update over that step",
            cpu["odometry_ratio"],
            ODOMETRY_RATIO,
        ),
        *vision_rows.checks(rows),
    ]
