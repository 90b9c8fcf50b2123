"""Figures of a summary, each a number with a name and a unit: for comparing two runs.

The names are those of `WalkMetrics`: the parts of a figure follow after a dot, as in
`end_to_end.p99`, `servo_load.FL` and `stages.mpc_controller.max`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from slot_core.robot import LEGS
from slot_lab.report.metrics import Latency, WalkMetrics

MM, MS, DEG, PERCENT = (
    (1e3, "mm"),
    (1e3, "ms"),
    (math.degrees(1.0), "deg"),
    (100.0, "%"),
)
COUNT, PLAIN = (1.0, ""), 1.0
UNITS: dict[str, tuple[float, str]] = {
    "duration": (PLAIN, "s"),
    "distance": (PLAIN, "m"),
    "mean_v_x": (PLAIN, "m/s"),
    "mean_v_y": (PLAIN, "m/s"),
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
    "behind": MS,
    "fallback_cycles": COUNT,
    "longest_fallback": COUNT,
    "violation_max": (PLAIN, "N"),
    "saturated": PERCENT,
    "rejected_odometry": COUNT,
    "servo_saturated": PERCENT,
    "servo_load": PERCENT,
    "supply_voltage": (PLAIN, "V"),
    "continuous_load": PERCENT,
}
"""Scale from SI and unit of the fields of `WalkMetrics`."""


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
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _parts(f"{name}.{key}", inner)
    elif isinstance(value, Latency):
        parts = dataclasses.asdict(value)
        yield from ((f"{name}.{part}", parts[part]) for part in ("p50", "p99", "max"))
    elif isinstance(value, tuple):
        yield from ((f"{name}.{leg}", float(part)) for leg, part in zip(LEGS, value))
    else:
        yield name, math.nan if value is None else float(value)
