"""Metrics of a recorded walk: motion, timing, MPC and servos; as figures, and as text.

A figure is a number with a name and a unit, for comparing two runs. Its name is a field of
`WalkMetrics`; the parts of a field follow after a dot, as in `end_to_end.p99`,
`servo_load.FL` and `stages.mpc_controller.max`.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.control.policy import Status
from slot_core.dynamics.servo import ServoSettings
from slot_core.estimation.estimate import USABLE
from slot_core.geometry import rotate
from slot_core.robot import LEGS
from slot_lab.bags.bag import Bag, BagError
from slot_lab.bags.recorded_walk import (
    STAGES,
    TorsoTrack,
    joint_columns,
    read_motion,
    read_ticks,
    seconds,
)
from slot_lab.bags.topics import MEASURED

NOT_KNOWN = (math.nan,) * len(LEGS)
NAME_WIDTH = 20
MM, MS, DEG = (1e3, "mm"), (1e3, "ms"), (math.degrees(1.0), "deg")
PERCENT, COUNT = (100.0, "%"), (1.0, "")
UNITS: dict[str, tuple[float, str]] = {
    "duration": (1.0, "s"),
    "distance": (1.0, "m"),
    "mean_v_x": (1.0, "m/s"),
    "mean_v_y": (1.0, "m/s"),
    "height_mean": MM,
    "height_std": MM,
    "tilt_rms": DEG,
    "tilt_max": DEG,
    "lateral_drift_max": MM,
    "lateral_drift_end": MM,
    "yaw_drift": DEG,
    "period": MS,
    "ticks": COUNT,
    "deadline_misses": COUNT,
    "unanswered": COUNT,
    "missed_ticks": COUNT,
    "stages": MS,
    "end_to_end": MS,
    "real_time_factor": COUNT,
    "fallback_cycles": COUNT,
    "longest_fallback": COUNT,
    "violation_max": (1.0, "N"),
    "saturated": PERCENT,
    "unusable_states": COUNT,
    "servo_saturated": PERCENT,
    "servo_load": PERCENT,
    "supply_voltage": (1.0, "V"),
    "continuous_load": PERCENT,
}
"""Scale from SI and unit of the fields of `WalkMetrics`."""


@dataclass(frozen=True)
class Latency:
    """Distribution of one latency, s; NaN where nothing was measured."""

    count: int
    p50: float
    p99: float
    max: float


@dataclass(frozen=True)
class WalkMetrics:
    """Metrics of one walk after the warm-up; None or NaN where the bag lacks the data.

    Drift is measured from a straight line, which starts where the warm-up ends and points along the
    robot's heading at the start of the bag.
    """

    source: str  # topic of the motion: ground truth if it was recorded
    warm_up: float  # s left out
    duration: float  # s, graph time
    distance: float  # m, horizontal, from the first to the last position
    mean_v_x: float  # m/s along the momentary heading
    mean_v_y: float  # m/s left of it
    height_mean: float  # m, of base_link
    height_std: float  # m
    tilt_rms: float  # rad, angle between body z and world z
    tilt_max: float  # rad
    lateral_drift_max: float  # m, largest distance from the line
    lateral_drift_end: float  # m, last distance from the line, left positive
    yaw_drift: float  # rad, last yaw minus the heading of the line
    period: float  # s, control period
    ticks: int  # states that require a command
    # ticks whose command came over a period later, or never
    deadline_misses: int
    unanswered: int  # ticks without a command
    missed_ticks: int  # gaps in the stamps
    stages: dict[str, Latency]  # by node
    end_to_end: Latency
    real_time_factor: float  # graph time over wall time
    fallback_cycles: int | None  # MPC cycles without a solution
    longest_fallback: int | None  # consecutive ones
    violation_max: float  # N, largest constraint violation
    # share of cycles, per leg, with an angle at its limit
    saturated: tuple[float, ...]
    unusable_states: int | None
    # share of samples, per leg, at the stall torque
    servo_saturated: tuple[float, ...]
    servo_load: tuple[float, ...]  # mean torque over stall torque, per leg
    # V, mean of the servos; NaN: the nominal one is assumed
    supply_voltage: float
    continuous_load: float  # largest mean load that the maker advises


def walk_metrics(bag: Bag, warm_up: float, servo: ServoSettings) -> WalkMetrics:
    """Compute the metrics of a walk.

    `warm_up` is the time left out at the start, s of graph time; `servo` has the stall torque at a
    supply voltage. Raises BagError if less than two samples are left.
    """
    whole = read_motion(bag)
    start = whole.t[0] + warm_up
    motion = whole.between(start)
    if len(motion.t) < 2:
        span = whole.t[-1] - whole.t[0]
        raise BagError(
            f"{bag.path}: holds {span:.1f} s, the warm-up leaves out {warm_up:.1f} s"
        )
    return WalkMetrics(
        source=motion.source,
        warm_up=warm_up,
        **_progress(motion),
        **_drift(whole, motion),
        **_timing(bag, start),
        **_control(bag, start),
        **_servos(bag, start, servo),
    )


def latency(values: Array) -> Latency:
    """Percentiles of latencies in s; NaN entries are ignored."""
    values = values[np.isfinite(values)]
    if not len(values):
        return Latency(0, math.nan, math.nan, math.nan)
    p50, p99 = np.percentile(values, [50, 99])
    return Latency(len(values), float(p50), float(p99), float(values.max()))


def _progress(motion: TorsoTrack) -> dict[str, Any]:
    duration = float(motion.t[-1] - motion.t[0])
    steps = np.diff(motion.position[:, :2], axis=0)
    forward, left = (
        rotate(steps, -((motion.rpy[1:, 2] + motion.rpy[:-1, 2]) / 2)).sum(
            axis=0
        )
        / duration
    )
    height = motion.position[:, 2]
    return {
        "duration": duration,
        "distance": float(np.linalg.norm(steps.sum(axis=0))),
        "mean_v_x": float(forward),
        "mean_v_y": float(left),
        "height_mean": float(height.mean()),
        "height_std": float(height.std()),
        "tilt_rms": math.sqrt(float(np.mean(motion.tilt**2))),
        "tilt_max": float(motion.tilt.max()),
    }


def _drift(whole: TorsoTrack, motion: TorsoTrack) -> dict[str, Any]:
    heading, yaw = whole.rpy[[0, -1], 2]
    across = rotate(motion.position[:, :2] - motion.position[0, :2], -heading)[
        :, 1
    ]
    return {
        "lateral_drift_max": float(np.abs(across).max()),
        "lateral_drift_end": float(across[-1]),
        "yaw_drift": float(yaw - heading),
    }


def _timing(bag: Bag, start: float) -> dict[str, Any]:
    ticks = read_ticks(bag).after(start)
    answered = np.isfinite(ticks.time[:, -1])
    # A tick counts only if its command was recorded or the recording went on for a period after it.
    due = answered | (ticks.time[:, 0] + ticks.period <= ticks.end)
    late = answered & (ticks.end_to_end > ticks.period)
    # of ticks whose sensor's message was recorded: a recorder that is late loses some
    sensed = np.isfinite(ticks.time[:, 0])
    wall = np.ptp(ticks.time[sensed, 0]) if sensed.any() else 0.0
    gaps = np.rint(np.diff(ticks.stamp) / ticks.period).astype(int) - 1
    return {
        "period": ticks.period,
        "ticks": int(due.sum()),
        "deadline_misses": int(late.sum() + (due & ~answered).sum()),
        "unanswered": int((due & ~answered).sum()),
        "missed_ticks": int(gaps.clip(min=0).sum()),
        "stages": {
            name: latency(ticks.latency[:, i]) for i, name in enumerate(STAGES)
        },
        "end_to_end": latency(ticks.end_to_end),
        "real_time_factor": float(np.ptp(ticks.stamp[sensed]) / wall)
        if wall > 0
        else math.nan,
    }


def _control(bag: Bag, start: float) -> dict[str, Any]:
    solves = _after(
        bag, start, "/tendon_plan", "status", "violation", "fallback_cycles"
    )
    states = _after(bag, start, "/mpc_state", "validity")
    maps = _after(bag, start, "/force_map/status", "saturated")
    violation = solves["violation"] if solves else np.zeros(0)
    # without the cycles that were rejected
    solved = violation[~np.isnan(violation)]
    return {
        "fallback_cycles": solves
        and int(np.sum(solves["status"] != Status.SOLVED)),
        "longest_fallback": solves and int(solves["fallback_cycles"].max()),
        "violation_max": float(solved.max()) if solved.size else math.nan,
        "saturated": _mean(maps["saturated"]) if maps else NOT_KNOWN,
        "unusable_states": states
        and int(np.sum(~np.isin(states["validity"], USABLE))),
    }


def _servos(bag: Bag, start: float, servo: ServoSettings) -> dict[str, Any]:
    voltage = _supply_voltage(bag, start)
    share = _torques(bag, start) / servo.tendon_stall(voltage)
    return {
        "servo_saturated": _mean(share >= 1.0),
        "servo_load": _mean(share),
        "supply_voltage": float(voltage.mean()),
        "continuous_load": servo.continuous_load,
    }


def _torques(bag: Bag, start: float) -> Array:
    """(n, 4) magnitudes of the servos' torques, N m; n = 0 where they are not recorded."""
    if (
        not bag.counts.get(MEASURED)
        or not bag.series(MEASURED, "effort")["effort"].size
    ):
        return np.empty((0, len(LEGS)))  # a JointState may have no efforts
    t, torque = joint_columns(bag, MEASURED, "effort")
    return np.abs(torque[t >= start])


def _supply_voltage(bag: Bag, start: float) -> Array:
    """(4,) medians of the supply voltages that the servos report, V; NaN: not known."""
    health = _after(bag, start, "/servo_health", "voltage")
    if health is None:
        return np.array(NOT_KNOWN)
    known = [column[np.isfinite(column)] for column in health["voltage"].T]
    return np.array(
        [np.median(column) if len(column) else math.nan for column in known]
    )


def _after(
    bag: Bag, start: float, topic: str, *fields: str
) -> dict[str, Array] | None:
    """Fields of a topic at or after graph time `start`; None if there are no messages."""
    if topic not in bag.topics:
        return None
    series = bag.series(topic, *fields)
    keep = seconds(series.stamp) >= start
    return (
        {field: series[field][keep] for field in fields} if keep.any() else None
    )


def _mean(rows: NDArray[Any]) -> tuple[float, ...]:
    return (
        tuple(float(f) for f in rows.mean(axis=0)) if len(rows) else NOT_KNOWN
    )


@dataclass(frozen=True)
class Figure:
    """One number of a summary; NaN where the bag lacks the data."""

    name: str
    value: float
    unit: str


def figures(metrics: WalkMetrics) -> list[Figure]:
    """The figures of a walk in the order of its metrics."""
    return [
        Figure(name, scale * value, unit)
        for field, (scale, unit) in UNITS.items()
        for name, value in _parts(field, getattr(metrics, field))
    ]


def _parts(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """Numbers in a field, with their names; the number of a latency's samples is left out."""
    if isinstance(value, Latency):
        value = {"p50": value.p50, "p99": value.p99, "max": value.max}
    elif isinstance(value, tuple):
        value = dict(zip(LEGS, value))
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _parts(f"{name}.{key}", inner)
    else:
        yield name, math.nan if value is None else float(value)


def summary_lines(metrics: WalkMetrics) -> list[str]:
    """Aligned lines `name  values`, with units; a dash where the bag lacks the data."""
    m = metrics
    rows = [
        ("motion from", m.source),
        ("duration", f"{m.duration:.2f} s after {m.warm_up:.1f} s of warm-up"),
        ("distance", f"{m.distance:.3f} m"),
        ("mean v_x, v_y", f"{m.mean_v_x:.4f} m/s, {m.mean_v_y:+.4f} m/s"),
        (
            "height",
            f"{_mm(m.height_mean)} mean, {_mm(m.height_std)} standard deviation",
        ),
        ("tilt", f"{_deg(m.tilt_rms)} RMS, {_deg(m.tilt_max)} max"),
        (
            "lateral drift",
            f"{_mm(m.lateral_drift_max)} max, {_mm(m.lateral_drift_end, '+')} end",
        ),
        ("yaw drift", _deg(m.yaw_drift, "+")),
        *((name, _latency(stage)) for name, stage in m.stages.items()),
        ("end to end", _latency(m.end_to_end)),
        (
            "deadline misses",
            f"{m.deadline_misses} of {m.ticks} ticks later than {1e3 * m.period:.1f} ms",
        ),
        (
            "  never answered",
            f"{m.unanswered} ticks, {m.missed_ticks} left out",
        ),
        ("real-time factor", _number(m.real_time_factor, "{:.2f}")),
        (
            "MPC fallback",
            (
                "-"
                if m.fallback_cycles is None
                else f"{m.fallback_cycles} cycles, at most {m.longest_fallback} in a row"
            ),
        ),
        ("largest violation", _number(m.violation_max, "{:.1e} N")),
        ("map saturated", _per_leg(m.saturated)),
        ("servo at stall", _per_leg(m.servo_saturated)),
        ("servo load", _per_leg(m.servo_load)),
        ("  all servos", _load(m)),
        (
            "unusable states",
            "-" if m.unusable_states is None else str(m.unusable_states),
        ),
    ]
    return [f"{name:<{NAME_WIDTH}}{value}" for name, value in rows]


def _mm(metres: float, sign: str = "") -> str:
    return f"{1e3 * metres:{sign}.1f} mm"


def _deg(radians: float, sign: str = "") -> str:
    return f"{math.degrees(radians):{sign}.2f} deg"


def _number(value: float, form: str) -> str:
    return form.format(value) if math.isfinite(value) else "-"


def _latency(stage: Latency) -> str:
    line = (
        f"p50 {1e3 * stage.p50:6.2f}   p99 {1e3 * stage.p99:6.2f}"
        f"   max {1e3 * stage.max:6.2f} ms"
    )
    return line if stage.count else "-"


def _load(metrics: WalkMetrics) -> str:
    """Mean load of the servos beside the load that the maker advises."""
    load, voltage = sum(metrics.servo_load) / len(LEGS), metrics.supply_voltage
    if not math.isfinite(load):
        return "-"
    stall = (
        f"stall at {voltage:.1f} V"
        if math.isfinite(voltage)
        else "nominal stall"
    )
    return (
        f"{100 * load:.1f} % of {stall};"
        f" the maker advises {100 * metrics.continuous_load:.0f} %"
    )


def _per_leg(fractions: Iterable[float]) -> str:
    return "   ".join(
        f"{leg} {_number(100 * f, '{:.1f} %')}"
        for leg, f in zip(LEGS, fractions)
    )
