"""Detection of a walk that does not move: the commanded angles swing, the torso does not.

Over the last `window` the torso moves by the extent d of its pose,

    d^2 = x^2 + y^2 + z^2 + `lever`^2 (roll^2 + pitch^2 + yaw^2)   with the extents of each,

and the commands by the largest extent c of an angle. Legs that bend move the torso by d / c, in
whatever direction: on its place, where the feet slide, or where the torso lies on the floor.
Commands below `command_min` ask for no motion.
"""

from collections import deque

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import SECOND
from slot_core.matrices import norm
from slot_core.safety.settings import MotionLimits


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


class MotionWatch:
    """Poses and commands of the last window, and the alarm from them."""

    def __init__(self, limits: MotionLimits) -> None:
        self._limits = limits
        self._window = MovingWindow()  # of pose (6,) and command (4,)
        self.reset()

    def reset(self) -> None:
        """Discard poses and alarm."""
        self.message = ""  # one line once no motion was seen, until the reset
        self.pause()

    def pause(self) -> None:
        """Discard the poses, but not the alarm."""
        self._window.clear()

    def observe(self, time: int, state: Array, command: Array) -> None:
        """Take the state (12,) of the torso and the command (4,), rad, at `time` (ns)."""
        if not np.isfinite(state).all():
            return
        row = np.concatenate([state[:6], command])
        if (
            self._window.add(time, row, self._limits.window)
            and not self.message
        ):
            self._evaluate()

    def _evaluate(self) -> None:
        """Set the alarm if the window shows commands without motion."""
        rows, limits = self._window.rows(), self._limits
        rows[:, 2] = np.unwrap(rows[:, 2])
        extent = np.ptp(rows, axis=0)
        moved = norm(extent[:6] * ([limits.lever] * 3 + [1.0] * 3))
        asked = float(extent[6:].max())
        if asked >= limits.command_min and moved < limits.ratio_min * asked:
            self.message = (
                f"no motion seen: torso {1e3 * moved:.1f} mm, limit"
                f" {1e3 * limits.ratio_min * asked:.1f} mm, in {limits.window:g} s with commands of"
                f" {asked:.2f} rad"
            )
