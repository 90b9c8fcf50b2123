"""Readings of the last seconds."""

from __future__ import annotations

from collections import deque

import numpy as np

from slot_core.clock import SECOND
from slot_core.robot import Array


class MovingWindow:
    """Rows with their times, the newest last; times never go back."""

    def __init__(self) -> None:
        self._rows: deque[tuple[int, Array]] = deque()

    def clear(self) -> None:
        """Discard all rows."""
        self._rows.clear()

    @property
    def newest(self) -> int | None:
        """Time of the newest row, ns; None: there is none."""
        return self._rows[-1][0] if self._rows else None

    def add(self, time: int, row: Array, length: float) -> bool:
        """Add a row at `time` (ns), drop those older than `length` (s); whether there were any."""
        self._rows.append((time, row))
        is_full = False
        while time - self._rows[0][0] >= length * SECOND:
            self._rows.popleft()
            is_full = True
        return is_full

    def rows(self) -> Array:
        """All rows, one array."""
        return np.array([row for _, row in self._rows])
