"""Clocks and units of time."""

from __future__ import annotations

from collections.abc import Callable

SECOND = 1_000_000_000  # ns
Clock = Callable[[], float]  # monotonic time, s
