"""Pace: late and skipped controller cycles, and how fast time and counts go on."""

import math
from collections import deque


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


class Speed:
    """Change of a value per second of wall time over the last `window` (s)."""

    def __init__(self, window: float) -> None:
        self._window = window
        # s of wall time, value
        self._values: deque[tuple[float, float]] = deque()

    def add(self, at: float, value: float) -> None:
        """Take the value at `at`, s of a clock that never goes back."""
        self._values.append((at, value))
        self._drop(at)

    def until(self, now: float) -> float:
        """The change per second up to `now`, s; NaN before a whole window has passed.

        A value that is no longer reported has not changed.
        """
        self._drop(now)
        if not self._values or now - self._values[0][0] < self._window:
            return math.nan
        return (self._values[-1][1] - self._values[0][1]) / (
            now - self._values[0][0]
        )

    def _drop(self, now: float) -> None:
        """Drop the samples older than the window, but the newest of them."""
        while (
            len(self._values) > 1 and now - self._values[1][0] >= self._window
        ):
            self._values.popleft()
