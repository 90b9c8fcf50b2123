"""Clocks and units of time."""

from __future__ import annotations

from collections.abc import Callable

SECOND = 1_000_000_000  # ns
LOCKSTEP_START = SECOND  # ns, on the simulated clock; a stamp of zero means "no time" in ROS
Clock = Callable[[], float]  # monotonic time, s
