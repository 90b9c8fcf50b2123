"""Clocks of the simulated robot: how its time follows commands, or the real time.

    LockstepClock   the robot stops at every odometry reading until the command for it has come
    RealTimeClock   the robot follows a clock, in bounded portions

Times are ns.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from slot_core.simulation.plant import Plant, Reading

LOCKSTEP_START = 1_000_000_000  # ns; a stamp of zero means "no time" in ROS


class Clock(Protocol):
    """What the simulated robot needs of its clock."""

    def start(self, now: int) -> None:
        """Let the robot's time begin."""
        ...

    def present(self, now: int) -> int:
        """Stamp of the readings before the start."""
        ...

    def answer(self, stamp: int) -> Iterator[Reading]:
        """Advance as far as the command with `stamp` allows."""
        ...

    def follow(self, now: int) -> Iterator[Reading]:
        """Advance as far as the time `now` allows."""
        ...


class LockstepClock:
    """Time that advances by one odometry period with each answered reading."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._awaited = LOCKSTEP_START  # stamp of the odometry whose command lets time go on

    def start(self, now: int) -> None:
        """Let the robot's time begin at one second."""
        self._plant.start(LOCKSTEP_START)

    def present(self, now: int) -> int:
        """One second."""
        return LOCKSTEP_START

    def answer(self, stamp: int) -> Iterator[Reading]:
        """Advance to the next odometry reading if the command is for the last one."""
        if stamp == self._awaited:
            for reading in self._plant.advance_to_odometry():
                yield reading
            self._awaited = reading.stamp

    def follow(self, now: int) -> Iterator[Reading]:
        """Nothing: only commands advance the time."""
        return iter(())


class RealTimeClock:
    """Time that follows that of a clock."""

    def __init__(self, plant: Plant, portion: int) -> None:
        """`portion`: the most to simulate at once, ns, so that commands are taken in between."""
        self._plant, self._portion = plant, portion

    def start(self, now: int) -> None:
        """Let the robot's time begin now."""
        self._plant.start(now)

    def present(self, now: int) -> int:
        """Now."""
        return now

    def answer(self, stamp: int) -> Iterator[Reading]:
        """Nothing: commands do not advance the time."""
        return iter(())

    def follow(self, now: int) -> Iterator[Reading]:
        """Advance to `now`, by one portion at the most."""
        return self._plant.advance(min(now, self._plant.now + self._portion))

    def behind(self, now: int) -> int:
        """How far the robot's time is behind `now`, ns."""
        return now - self._plant.now
