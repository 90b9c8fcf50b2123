"""Clocks of the simulated robot: when its time advances.

    LockstepClock   by one odometry period per command
    RealTimeClock   with another clock, in bounded portions

Times are ns.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from slot_core.simulation.plant import Plant, Reading

LOCKSTEP_START = 1_000_000_000  # ns; a stamp of zero means "no time" in ROS


class SimulationClock(Protocol):
    """Interface of the clocks."""

    def start(self, now: int) -> None:
        """Start the time of the robot."""
        ...

    def rest_stamp(self, now: int) -> int:
        """Stamp of the readings before the start, ns."""
        ...

    def advance_on_command(self, stamp: int) -> Iterator[Reading]:
        """Advance as far as a command for the odometry at `stamp` allows; yield the readings."""
        ...

    def advance_to(self, now: int) -> Iterator[Reading]:
        """Advance as far as the time `now` allows; yield the readings."""
        ...


class LockstepClock:
    """Time that advances by one odometry period when the last reading has been answered."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._awaited = LOCKSTEP_START  # stamp of the odometry whose command is awaited

    def start(self, now: int) -> None:
        """Start the time of the robot at 1 s."""
        self._plant.start(LOCKSTEP_START)

    def rest_stamp(self, now: int) -> int:
        """Return 1 s, in ns."""
        return LOCKSTEP_START

    def advance_on_command(self, stamp: int) -> Iterator[Reading]:
        """Advance to the next odometry reading if `stamp` is that of the last one."""
        if stamp == self._awaited:
            for reading in self._plant.advance_to_odometry():
                yield reading
            self._awaited = reading.stamp

    def advance_to(self, now: int) -> Iterator[Reading]:
        """Do nothing: only commands advance the time."""
        return iter(())


class RealTimeClock:
    """Time that follows another clock."""

    def __init__(self, plant: Plant, portion: int) -> None:
        """`portion`: largest time to simulate at once, ns, so that commands are taken between."""
        self._plant, self._portion = plant, portion

    def start(self, now: int) -> None:
        """Start the time of the robot at `now`."""
        self._plant.start(now)

    def rest_stamp(self, now: int) -> int:
        """Return `now`."""
        return now

    def advance_on_command(self, stamp: int) -> Iterator[Reading]:
        """Do nothing: commands do not advance the time."""
        return iter(())

    def advance_to(self, now: int) -> Iterator[Reading]:
        """Advance towards `now` by at most one portion."""
        return self._plant.advance(min(now, self._plant.now + self._portion))

    def lag(self, now: int) -> int:
        """Time by which the robot is behind `now`, ns."""
        return now - self._plant.now
