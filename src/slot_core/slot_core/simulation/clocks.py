"""Clocks of the simulated robot: when its time advances.

    LockstepClock   by one odometry period per command
    RealTimeClock   with another clock, in bounded portions
    BusClock        so too, but it waits for a late driver of emulated servos

Times are ns.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from slot_core.clock import SECOND
from slot_core.simulation.bus_plant import BusPlant
from slot_core.simulation.plant import Plant, Reading

PATIENCE = SECOND // 2  # ns, longest wait for a late driver
LONGEST_CALL = SECOND // 100  # ns, of a wait, between two calls: a longer one was late itself
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


class BusClock(RealTimeClock):
    """Time that waits for the driver of emulated servos before a bus watchdog would stop them.

    The driver runs on the same machine, which may delay it by more than the watchdog's time. On a
    robot that delay does not exist, so the robot's time stops until the next instruction. A driver
    that sends none for PATIENCE has ended: then the time goes on, and the watchdogs stop the servos
    as soon after the last instruction, on the robot's clock, as on a robot.
    """

    def __init__(self, plant: BusPlant, portion: int) -> None:
        """`portion` as for RealTimeClock."""
        super().__init__(plant, portion)
        self._bus_plant = plant
        self._last = 0  # ns, `now` of the last call
        self.waited = 0  # ns, of the present wait for the driver

    def advance_to(self, now: int) -> Iterator[Reading]:
        """Advance towards `now` by at most one portion, and not past the next bus watchdog."""
        passed, self._last = now - self._last, now
        until, due = min(now, self._plant.now + self._portion), self._bus_plant.watchdog_due()
        if due is None or until <= due:
            self.waited = 0
        else:
            self.waited += min(passed, LONGEST_CALL)
            until = until if self.waited > PATIENCE else due
        return self._plant.advance(until)
