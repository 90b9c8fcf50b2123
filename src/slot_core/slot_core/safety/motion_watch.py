"""Detection of a walk that does not move, that slides, or that is slower than commanded.

No motion: the commanded angles swing, the torso does not. Over the last `window` the torso moves by
the extent d of its pose,

    d^2 = x^2 + y^2 + z^2 + `lever`^2 (roll^2 + pitch^2 + yaw^2)   with the extents of each,

and the commands by the largest extent c of an angle. Legs that bend move the torso by d / c, in
whatever direction: on its place, where the feet slide, or where the torso lies on the floor.
Commands below `command_min` ask for no motion.

Slip: over the last `slip_window` the mean velocity v of the torso is compared with the mean of the
commanded one, c, both in its heading frame,

    s = v - min(max(v . e, 0), |c|) e,   e = c / |c|:   what is no progress along the command.

Faster than `slip_max` the robot slides, faster than `slip_hold` than it could walk back, and legs
that hold stop it. Its progress v . e is slow below `progress_min` |c|, if |c| is above `slip_max`;
so it is for some time at corners and at the foot of a slope. Estimated velocities do not jump with
the origin of the odometry.
"""

from collections import deque

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import SECOND
from slot_core.geometry import rotate
from slot_core.matrices import norm
from slot_core.safety.settings import MotionLimits
from slot_core.safety.states import Condition

WAYS = (("ahead", "back"), ("left", "right"))
FILTER = 20  # ticks, a stride: the torso sways


class MovingWindow:
    """Rows of a shape with their times, the newest last; times never go back."""

    def __init__(self, *shape: int) -> None:
        self._shape = shape
        # as bytes, which are joined in a tenth of the time of arrays
        self._rows: deque[tuple[int, bytes]] = deque()

    def clear(self) -> None:
        """Discard all rows."""
        self._rows.clear()

    @property
    def newest(self) -> int | None:
        """Time of the newest row, ns; None: there is none."""
        return self._rows[-1][0] if self._rows else None

    def add(self, time: int, row: Array, length: float) -> bool:
        """Add a row at `time` (ns), drop those older than `length` (s); whether there were any."""
        self._rows.append((time, row.tobytes()))
        is_full = False
        while time - self._rows[0][0] >= length * SECOND:
            self._rows.popleft()
            is_full = True
        return is_full

    def rows(self) -> Array:
        """All rows, one array that cannot be written."""
        return np.frombuffer(b"".join([row for _, row in self._rows])).reshape(
            -1, *self._shape
        )


class MotionWatch:
    """Poses and commands of the last windows, and the alarms from them."""

    def __init__(self, limits: MotionLimits) -> None:
        self._limits = limits
        self._window = MovingWindow(10)  # of pose (6,) and command (4,)
        # of measured and commanded velocity
        self._velocities = MovingWindow(2, 3)
        self.reset()

    def reset(self) -> None:
        """Discard poses and alarms."""
        # lines on what was seen since the reset
        self._alarms: dict[Condition, str] = {}
        self.pause()

    def pause(self) -> None:
        """Discard the poses, but not the alarms."""
        self._window.clear()
        self._velocities.clear()
        # one line on a walk that is not as commanded, of once a second
        self._remark, self._compared = "", 0
        self._slow = 0  # s, for which the walk has been slow
        # velocities, filtered over FILTER ticks
        self._recent = np.zeros((2, 3))

    @property
    def findings(self) -> dict[Condition, str]:
        """Conditions, with one line each."""
        remark = {Condition.OFF_COMMAND: self._remark} if self._remark else {}
        return remark | self._alarms

    def observe(
        self, time: int, state: Array, command: Array, velocity: Array
    ) -> None:
        """Take the state (12,) of the torso and what is commanded at `time` (ns).

        command: (4,) rad. velocity: (3,) v_x, v_y, yaw rate in the heading frame, m/s, rad/s; zero:
        unknown, or to stand.
        """
        if not np.isfinite(state).all():
            return
        limits = self._limits
        row = np.concatenate([state[:6], command])
        if self._window.add(time, row, limits.window) and not self._alarms:
            self._seek_motion()
        moved = *rotate(state[9:11], -state[2]).tolist(), float(state[8])
        velocities = np.array([moved, velocity.tolist()])
        self._recent += (velocities - self._recent) / FILTER
        is_full = self._velocities.add(time, velocities, limits.slip_window)
        if is_full and time - self._compared >= SECOND:
            self._compared = time
            self._compare(*self._velocities.rows().mean(axis=0))

    @property
    def slides(self) -> bool:
        """Whether the torso has slid at twice `slip_hold` during the last stride.

        With a broken tendon it slides at up to 1.2 times `slip_hold` before the tendon is named.
        """
        return bool(norm(_slip(*self._recent)[1]) > 2 * self._limits.slip_hold)

    def _seek_motion(self) -> None:
        """Set the alarm if the window shows commands without motion."""
        rows, limits = self._window.rows(), self._limits
        extent = rows.max(axis=0) - rows.min(axis=0)
        asked = float(extent[6:].max())
        least = limits.ratio_min * asked
        if asked < limits.command_min or norm(extent[3:6]) >= least:
            return
        extent[2] = np.ptp(np.unwrap(rows[:, 2]))
        moved = norm(extent[:6] * ([limits.lever] * 3 + [1.0] * 3))
        if moved < least:
            self._alarms[Condition.NO_MOTION] = (
                f"no motion seen: torso {1e3 * moved:.1f} mm, limit"
                f" {1e3 * least:.1f} mm, in {limits.window:g} s with commands of"
                f" {asked:.2f} rad"
            )

    def _compare(self, moved: Array, asked: Array) -> None:
        """Compare mean velocities (3,): remark on slip and on slow walks, alarm on much slip."""
        self._remark, limits, speed = "", self._limits, norm(asked[:2])
        along, slip = _slip(moved, asked)
        fast, least = norm(slip), limits.progress_min * speed
        is_slow = speed > limits.slip_max and along < least
        self._slow = self._slow + 1 if is_slow else 0
        if fast > limits.slip_max and asked.any():
            axis = int(abs(slip[1]) > abs(slip[0]))
            most = fast > limits.slip_hold
            limit = limits.slip_hold if most else limits.slip_max
            self._remark = (
                f"slides {1e3 * fast:.0f} mm/s {WAYS[axis][int(slip[axis] < 0.0)]}, limit"
                f" {1e3 * limit:.0f}: floor too steep or too slippery, or the robot is pushed"
            )
            if most:
                self._alarms.setdefault(Condition.SLIDING, self._remark)
        elif self._slow > limits.slow_time:
            self._remark = (
                f"walks {1e3 * along:z.0f} of {1e3 * speed:.0f} mm/s, least {1e3 * least:.0f}:"
                " floor, slope, load or legs allow no more"
            )


def _slip(moved: Array, asked: Array) -> tuple[float, Array]:
    """Progress v . e (m/s) along the command, and the slip s (2,), of velocities (3,)."""
    speed = norm(asked[:2])
    way = asked[:2] / max(speed, 1e-9)
    along = float(np.sum(moved[:2] * way))
    return along, moved[:2] - min(max(along, 0.0), speed) * way
