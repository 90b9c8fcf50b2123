"""Counters of late and skipped controller cycles."""

from __future__ import annotations


class Pace:
    """Counts overruns (cycles longer than their period) and skipped inputs."""

    def __init__(self) -> None:
        self.overruns = 0
        self.skipped = 0
        self._last: int | None = None

    def add(self, number: int, elapsed: float, period: float) -> None:
        """Count a cycle of `elapsed` s for input `number`; it is an overrun above `period` s.

        A source numbers its inputs consecutively. A lower number means that the source restarted.
        """
        self.overruns += elapsed > period
        if self._last is not None and number > self._last:
            self.skipped += number - self._last - 1
        self._last = number
