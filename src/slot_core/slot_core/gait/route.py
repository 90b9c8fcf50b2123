"""Path on the floor that the robot follows: a polyline in odom, travelled at a speed.

The reference place travels along the path; it waits where it is LEAD ahead of the robot, along the
path. The heading is kept, or follows the path's direction.
"""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.elementary import atan2, cos, sin
from slot_core.geometry import wrapped
from slot_core.key_frame import StateParts
from slot_core.matrices import interpolated, norm
from slot_core.refusal import quoted, read_text

POINTS_MAX, SIZE_MAX = 100_000, 10_000_000  # of a file, bytes
FARTHEST = 1e6  # m from odom's origin
# heading: that at the start; the path's direction
KEPT, ALONG = ("kept", "along")
LEAD = 0.04  # m, of the reference place before the robot
ARRIVED = 0.005  # m along the path before its end, where the robot stops
CREEP = 0.25  # least share of the speed before the end
# 1/s, yaw rate per heading error, where the heading follows the path
TURN_GAIN = 1.0


class Route:
    """Polyline, and the reference place on it."""

    STATE = StateParts("travelled", "_start_yaw", "_arrived")

    def __init__(self, points: Array, heading: str):
        """Take points (n, 2) m in odom.

        heading: "kept", that at the start, or "along" the path. Raises ConfigError for less than
        two different points.
        """
        moved = np.diff(points, axis=0).any(axis=1)
        self._points = points[np.r_[True, moved][: len(points)]]
        if len(self._points) < 2:
            raise ConfigError("path: needs at least two different points")
        steps = np.diff(self._points, axis=0)
        self._arc = np.r_[0.0, np.cumsum(norm(steps))]
        self._direction = atan2(steps[:, 1], steps[:, 0])
        self._along = heading == ALONG
        self._start_yaw: float | None = None
        self.travelled = 0.0  # m, of the reference place
        self._arrived = False

    @property
    def length(self) -> float:
        """Length, m."""
        return float(self._arc[-1])

    def place(self, state: Array, elapsed: float, speed: float) -> Array:
        """Advance the reference place for `elapsed` (s) at a speed (m/s); x, y (m), yaw (rad)."""
        if self._lead(state) < LEAD:
            self.travelled = min(self.travelled + speed * elapsed, self.length)
        return np.array([*self._point(self.travelled), self._yaw(state)])

    def velocity(self, state: Array, speed: float) -> Array:
        """Velocity (3,) in base_link along the path at a speed (m/s).

        It falls from LEAD before the end on. The robot stops where it reaches or passes the end.
        """
        if self.travelled >= self.length:
            left = self._lead(state)
            self._arrived = self._arrived or left < ARRIVED
            if self._arrived:
                return np.zeros(3)
            speed *= min(1.0, max(left / LEAD, CREEP))
        along = self._direction[self._segment()] - state[2]
        error = wrapped(self._yaw(state) - state[2])
        turn = TURN_GAIN * error if self._along else 0.0
        return np.array([speed * cos(along), speed * sin(along), turn])

    def ahead(
        self,
        place: Array,
        times: Array,
        speed: float,
        reached: Callable[[Array], Array],
        last: Array,
    ) -> tuple[Array, Array]:
        """Velocities (n, 3) and places (n, 3) at `times` (s) ahead, of a place (3,) on the path.

        reached: gives the velocity that the gait reaches of a wanted one; last: (3,) beyond the
        end of the path.
        """
        arc = np.minimum(self.travelled + speed * times, self.length)
        xy = np.column_stack(
            [interpolated(arc, self._arc, axis) for axis in self._points.T]
        )
        xy += place[:2] - xy[0]
        yaw, velocity = np.full(len(times), place[2]), np.zeros((len(times), 3))
        for k, way in enumerate(self._direction[self._segments(arc)]):
            along = way - yaw[k]
            turn = TURN_GAIN * wrapped(along) if self._along else 0.0
            wanted = np.array([speed * cos(along), speed * sin(along), turn])
            velocity[k] = reached(wanted) if arc[k] < self.length else last
            if k + 1 < len(times):
                yaw[k + 1] = yaw[k] + (times[k + 1] - times[k]) * velocity[k, 2]
        return velocity, np.column_stack([xy, yaw])

    def _lead(self, state: Array) -> float:
        """Distance of the reference place before the robot, along the path, m."""
        direction = self._direction[self._segment()]
        gap = self._point(self.travelled) - state[3:5]
        return float(gap[0] * cos(direction) + gap[1] * sin(direction))

    def _segment(self) -> int:
        return int(self._segments(self.travelled))

    def _segments(self, arc: float | Array) -> NDArray[np.int_]:
        """Indices of the segments at lengths of arc (m)."""
        index = np.searchsorted(self._arc, arc, side="right") - 1
        return np.minimum(index, len(self._direction) - 1)

    def _yaw(self, state: Array) -> float:
        if self._along:
            return float(self._direction[self._segment()])
        if self._start_yaw is None:
            self._start_yaw = float(state[2])
        return self._start_yaw

    def _point(self, travelled: float) -> Array:
        return np.array(
            [
                interpolated(travelled, self._arc, axis)
                for axis in self._points.T
            ]
        )


def read_route(file: Path | str, heading: str) -> Route:
    """The path of a CSV file with columns x, y (m); heading as in `Route`. Raises ConfigError."""
    if heading not in (KEPT, ALONG):
        raise ConfigError(
            f"path_heading = {quoted(heading)}: expected one of kept, along"
        )
    try:
        lines = read_text(Path(file), SIZE_MAX).splitlines()
        rows = [
            [float(row["x"]), float(row["y"])] for row in csv.DictReader(lines)
        ]
    except (OSError, KeyError, TypeError, ValueError, csv.Error) as error:
        raise ConfigError(
            f"{file}: no path with columns x, y: {error}"
        ) from None
    points = np.array(rows).reshape(-1, 2)
    # NaN is not
    if len(rows) > POINTS_MAX or not (np.abs(points) <= FARTHEST).all():
        raise ConfigError(
            f"{file}: more than {POINTS_MAX} points, or a value not within +-{FARTHEST:g} m"
        )
    return Route(points, heading)
