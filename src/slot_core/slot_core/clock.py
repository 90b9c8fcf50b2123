"""Clocks and units of time: stamps are integers of nanoseconds, durations seconds."""

from collections.abc import Callable
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

SECOND = 1_000_000_000  # ns
# ns, on the simulated clock; a stamp of zero means "no time" in ROS
LOCKSTEP_START = SECOND
Clock = Callable[[], float]  # monotonic time, s


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
