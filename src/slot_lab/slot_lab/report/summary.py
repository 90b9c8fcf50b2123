"""Text summary of a walk's metrics."""

from __future__ import annotations

import math
from collections.abc import Iterable

from slot_core.robot import LEGS
from slot_lab.report.metrics import Latency, WalkMetrics

NAME_WIDTH = 20


def summary_lines(metrics: WalkMetrics) -> list[str]:
    """Aligned lines `name  values`, with units; a dash where the bag lacks the data."""
    m = metrics
    misses = (
        f"{m.deadline_misses} of {m.ticks} ticks later than {1e3 * m.period:.1f} ms"
    )
    unanswered = f"{m.unanswered} ticks, {m.missed_ticks} odometries missing"
    most = f"at most {m.longest_fallback} in a row"
    fallback = (
        "-" if m.fallback_cycles is None else f"{m.fallback_cycles} cycles, {most}"
    )
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
        ("deadline misses", misses),
        ("  never answered", unanswered),
        ("real-time factor", _number(m.real_time_factor, "{:.2f}")),
        ("  behind real time", _latency(m.behind)),
        ("MPC fallback", fallback),
        ("largest violation", _number(m.violation_max, "{:.1e} N")),
        ("map saturated", _per_leg(m.saturated)),
        ("servo at stall", _per_leg(m.servo_saturated)),
        ("servo load", _per_leg(m.servo_load)),
        ("  all servos", _load(m)),
        (
            "rejected odometry",
            "-" if m.rejected_odometry is None else str(m.rejected_odometry),
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
    if not stage.count:
        return "-"
    p50, p99, largest = (1e3 * value for value in (stage.p50, stage.p99, stage.max))
    return f"p50 {p50:6.2f}   p99 {p99:6.2f}   max {largest:6.2f} ms"


def _load(metrics: WalkMetrics) -> str:
    """Mean load of the servos beside the one that the maker advises."""
    load, voltage = sum(metrics.servo_load) / len(LEGS), metrics.supply_voltage
    if not math.isfinite(load):
        return "-"
    stall = f"stall at {voltage:.1f} V" if math.isfinite(voltage) else "nominal stall"
    advised = f"{100 * metrics.continuous_load:.0f} %"
    return f"{100 * load:.1f} % of {stall}; the maker advises {advised}"


def _per_leg(fractions: Iterable[float]) -> str:
    return "   ".join(
        f"{leg} {_number(100 * f, '{:.1f} %')}" for leg, f in zip(LEGS, fractions)
    )
