"""Clocks and units of time: stamps are integers of nanoseconds, durations seconds."""

from collections.abc import Callable
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

SECOND = 1_000_000_000  # ns
# ns, on the simulated clock; a stamp of zero means "no time" in ROS
LOCKSTEP_START = SECOND
Clock = Callable[[], float]  # monotonic time, s
LONGEST_GAP = 600.0  # s, between two samples of a recording
LONGEST = 14_400.0  # s, of a recording
UNITS = {5e5: "ns", 500.0: "us", 0.5: "ms", 1e-5: "s", 0.0: "days"}
"""Likely units of times, by the least median step of a recording."""


@overload
def to_seconds(ns: float) -> float: ...
@overload
def to_seconds(ns: NDArray[Any]) -> NDArray[np.float64]: ...
def to_seconds(ns: Any) -> Any:
    """Seconds of a number, or of an array, of nanoseconds."""
    return ns / SECOND


def to_ns(seconds: float) -> int:
    """Nanoseconds of a number of seconds, rounded."""
    return round(seconds * SECOND)


def unit_of(t: NDArray[Any]) -> str:
    """Likely unit of increasing times (n,) of a recording, by their median step."""
    step = np.median(np.diff(t)) if len(t) > 1 else 0.1
    return next(unit for least, unit in UNITS.items() if step >= least)


def time_fault(t: NDArray[Any]) -> str:
    """Reason why increasing times (n,), s, are no recording's by one clock; else empty."""
    steps = np.diff(t, prepend=t[:1])
    if not len(t) or max(steps.max() / LONGEST_GAP, steps.sum() / LONGEST) <= 1:
        return ""
    k = int(np.argmax(steps))
    if steps[k] > LONGEST_GAP:
        return (
            f"steps by {steps[k]:.4g} s to {t[k]:.10g} s, limit {LONGEST_GAP:g} s: was the"
            " clock set? cut the recording there"
        )
    return f"spans {steps.sum():.4g} s, limit {LONGEST:g} s: cut the recording"
