"""Error of the state at the time when the MPC uses it, with poor odometry, and of vision.

Sensor streams come from walks in simulation, with the sensors' noise of config/scene/flat.yaml;
delays and a loss are put on them. Three ways are compared: the authors' finite differences
with zero angular rates, the filter's state at the stamp of the odometry, and the state predicted
with the IMU to its newest sample. Errors are RMS over all axes, at the arrival of the odometry or,
of the last way, at the ticks.
Vision, on rendered images: `vision_rows.py`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.estimation import methods, vision_rows
from benchmarks.estimation.measured_streams import (
    WARM_UP,
    Slam,
    Streams,
    record,
    walked,
)
from benchmarks.harness import (
    Check,
    Outcome,
    Progress,
    Row,
    at_least,
    at_most,
    cpu_time,
    timed,
)
from slot_core.arrays import Array
from slot_core.clock import SECOND
from slot_core.estimation.inertial_filter import EstimatorSettings
from slot_core.estimation.state_estimator import read_estimator
from slot_core.geometry import wrapped
from slot_core.simulation.readings import ImuReading

# s, with jitter
DELAYS = ((0.0, 0.0), (0.02, 0.01), (0.05, 0.02), (0.08, 0.02))
ERRORS = {  # parts of the state
    "roll_pitch_mrad": slice(0, 2),
    "position_mm": slice(3, 6),
    "rate_mrad_s": slice(6, 9),
    "velocity_mm_s": slice(9, 12),
}
WAYS = {  # to the state
    "finite differences": methods.finite_differences,
    "without prediction": methods.without_prediction,
    "predicted": methods.predicted,
}
# over the walk; steps of a filter in NumPy after each
PASSES, PLAIN_STEPS = (7, 1000)
# CPU of the estimator per IMU sample, with its ticks, over such a step; 1.06 was measured
SAMPLE_RATIO = 1.4


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Measure; `quick`: one walk of 10 s in place of twenty of 20 s, eight in closed loop."""
    seeds, duration = (range(1), 10.0) if quick else (range(20), 20.0)
    settings = read_estimator()
    progress(f"{len(seeds)} walks of {duration:g} s")
    walks = [record(seed, duration) for seed in seeds]
    rows: list[Row] = []
    for slam in (Slam(delay, jitter) for delay, jitter in DELAYS):
        progress(f"odometry {1e3 * slam.delay:g} ms late")
        rows += [method_row(walks, slam, settings, name) for name in WAYS]
    lost = Slam(0.05, 0.02, gap=(5.0, 6.0))
    beyond = np.max(
        [error_after_loss(walk, lost, settings) for walk in walks], axis=0
    )
    rows.append(cpu_row(walks[0], settings))
    rows += closed_loop_rows(range(8 if quick else 20), progress)
    rows += vision_rows.rows(quick, progress)
    return rows, checks(rows, *beyond)


def method_row(
    walks: list[Streams], slam: Slam, settings: EstimatorSettings, name: str
) -> Row:
    """RMS errors of a way to the state over the walks."""
    errors = np.vstack(
        [errors_at_use(walk, slam, WAYS[name], settings) for walk in walks]
    )
    rms = {
        key: 1e3 * float(np.sqrt(np.mean(errors[:, part] ** 2)))
        for key, part in ERRORS.items()
    }
    return {
        "kind": "delay",
        "method": name,
        "delay_ms": 1e3 * slam.delay,
        "jitter_ms": 1e3 * slam.jitter,
        "ticks": len(errors),
        **rms,
    }


def errors_at_use(
    walk: Streams, slam: Slam, way: methods.Way, settings: EstimatorSettings
) -> Array:
    """Errors (n, 12) of the states when they are used, after the warm-up."""
    arrivals = slam.arrivals(walk, np.random.default_rng(0))
    start = walk.stamps[0] + WARM_UP * SECOND
    return np.array(
        [
            difference(state, walk.true_state(at))
            for at, state in way(arrivals, settings)
            if start < at <= walk.stamps[-1]
        ]
    )


def difference(state: Array, true: Array) -> Array:
    """Error (12,) of a state, angles wrapped."""
    error = state - true
    error[:3] = wrapped(error[:3])
    return error


def error_after_loss(
    walk: Streams, slam: Slam, settings: EstimatorSettings
) -> Array:
    """Largest error of [position, velocity] before the odometry returns, m and m/s."""
    arrivals = slam.arrivals(walk, np.random.default_rng(0))
    end = walk.stamps[0] + slam.gap[1] * SECOND
    used = [
        (t, s) for t, s in methods.predicted(arrivals, settings) if t <= end
    ]
    error = difference(used[-1][1], walk.true_state(used[-1][0]))
    return np.array([np.abs(error[3:6]).max(), np.abs(error[9:12]).max()])


def cpu_row(walk: Streams, settings: EstimatorSettings) -> Row:
    """CPU time per IMU sample, with odometry 50 ms late, and over one step in NumPy and SciPy.

    Medians of passes over the walk, each followed by such steps.
    """
    arrivals = [*Slam(0.05).arrivals(walk, np.random.default_rng(0))]
    samples = sum(isinstance(reading, ImuReading) for _, reading in arrivals)
    passes = np.empty((PASSES, 2))
    for figures in passes:
        _, used = timed(list, methods.predicted(arrivals, settings))
        figures[:] = (
            used / samples,
            cpu_time(methods.plain_step, 1, PLAIN_STEPS),
        )
    sample, plain = 1e6 * np.median(passes, axis=0)
    return {
        "kind": "cpu",
        "sample_us": sample,
        "plain_step_us": plain,
        "ratio": np.median(passes[:, 0] / passes[:, 1]),
    }


def closed_loop_rows(seeds: Sequence[int], progress: Progress) -> list[Row]:
    """Errors of the walk with late odometry: velocity, drift to the side, tilt over 8 s.

    Means over the seeds; the drift alone varies by 15 % from seed to seed.
    """
    rows: list[Row] = []
    for delay in (0.01, 0.08):
        progress(f"{len(seeds)} walks with odometry {1e3 * delay:g} ms late")
        late, found = {"scene.sensors.odometry.delay": delay}, []
        for seed in seeds:
            states, figures = walked(seed, 10.0, late).motion()
            found.append(
                figures
                | {"tilt_mrad": 1e3 * np.sqrt(np.mean(states[:, 0:2] ** 2))}
            )
        rows.append(
            {
                "kind": "closed loop",
                "delay_ms": 1e3 * delay,
                "seeds": len(seeds),
            }
            | {key: np.mean([each[key] for each in found]) for key in found[0]}
        )
    return rows


def checks(rows: list[Row], place: float, speed: float) -> list[Check]:
    """Figures that have a goal; place, speed: largest errors after a second without odometry, SI."""

    def row(**wanted: Any) -> Row:
        (found,) = [r for r in rows if wanted.items() <= r.items()]
        return found

    ours = row(kind="delay", method="predicted", delay_ms=50.0)
    authors = row(kind="delay", method="finite differences", delay_ms=50.0)
    near, far = (
        row(kind="closed loop", delay_ms=delay) for delay in (10.0, 80.0)
    )
    faster = authors["velocity_mm_s"] / ours["velocity_mm_s"]
    change = abs(far["v_x_mm_s"] / near["v_x_mm_s"] - 1.0)
    lost = "after 1 s without odometry"
    return [
        at_most("position, 50 ms late", ours["position_mm"], 2.0, "mm"),
        at_most("velocity, 50 ms late", ours["velocity_mm_s"], 10.0, "mm/s"),
        at_most(
            "roll and pitch, 50 ms late", ours["roll_pitch_mrad"], 5.0, "mrad"
        ),
        at_least("velocity error of finite differences", faster, 3),
        at_most(f"position {lost}", 1e3 * place, 50.0, "mm"),
        at_most(f"velocity {lost}", 1e3 * speed, 50.0, "mm/s"),
        at_most("v_x, 80 ms late", change, 0.05),
        *(
            at_most(f"{key} added by 80 ms", far[key] / near[key] - 1, 0.05)
            for key in ("lateral_mm", "tilt_mrad")
        ),
        at_most(
            "CPU of an IMU sample over a step in NumPy",
            row(kind="cpu")["ratio"],
            SAMPLE_RATIO,
        ),
        *vision_rows.checks(rows),
    ]
