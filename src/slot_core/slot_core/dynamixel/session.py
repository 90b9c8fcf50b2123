"""Commands to servos: the driver behind the command watchdog, and the pace of its bus.

The watchdog (`safety/command_watchdog.py`) says what becomes of the supervisor's word, of
commands, silence and faults. Times are those of a clock that never goes back, ns.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slot_core.clock import SECOND
from slot_core.dynamixel.checks import ServoInfo
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.errors import RefusedError
from slot_core.dynamixel.state import Cycle, TorqueOff
from slot_core.robot import LEGS, Array
from slot_core.safety.command_gate import Action
from slot_core.safety.command_watchdog import CommandWatchdog, Word
from slot_core.safety.settings import SupervisorSettings

LATE = 1.5  # periods between two cycles that count as an overrun


@dataclass(frozen=True)
class MeasuredJoints:
    """Tendon angles (rad), rates and servo torques (N m), each (4,), at `stamp` (ns)."""

    stamp: int
    angle: Array
    rate: Array
    torque: Array


@dataclass(frozen=True)
class BusPace:
    """How the bus has kept its rate since the last look."""

    rate: float  # cycles a second
    mean: float  # s, of the cycles
    longest: float  # s
    overruns: int  # since the start


class ServoSession:
    """One driver, switched on, commanded, watched and switched off."""

    def __init__(
        self,
        driver: Driver,
        settings: SupervisorSettings,
        angle_max: float,
        period: float,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """`period` (s) between two steps; `sleep` waits within `stop`."""
        limit = min(angle_max, *(joint.high for joint in driver.joints))
        self.driver = driver
        self.period = period
        self.action, self.reason = Action.OFF, "not started"
        self.overruns = 0
        self.commanded = 0  # ns, stamp of the last command whose goals were written
        self.written = 0.0  # s of the driver's clock, when they were
        self._settings, self._sleep = settings, sleep
        self._watchdog = CommandWatchdog(settings, limit)
        self._offered = 0  # stamp of the last good command
        self._stepped: int | None = None
        self._looked: int | None = None
        self._durations: list[float] = []

    def configure(self) -> tuple[ServoInfo, ...]:
        """Open the port, check every servo, switch off what a killed driver has left under torque.

        Raises PortError, RefusedError.
        """
        infos = self.driver.configure()
        off = self.driver.torque_off()
        if not off.complete:
            raise RefusedError(list(off.reasons))
        return infos

    def start(self) -> None:
        """Torque on without motion; raises RefusedError, and then all torque is off."""
        try:
            self.driver.activate()
        except RefusedError as error:
            self.action, self.reason = Action.OFF, f"torque refused: {error}"
            raise
        self._watchdog.engage(self.driver.goals())
        self._stepped = None
        self.action, self.reason = Action.HOLD, "torque comes on"

    def offer(self, now: int, stamp: int, angle: Array) -> str:
        """Take tendon angles (4,), rad, of a `stamp`, as a whole; or refuse them and say why."""
        fault = self._watchdog.offer(now, angle)
        if not fault:
            self._offered = stamp
        return fault

    def permit(self, word: Word) -> None:
        """Hear the supervisor; OFF is obeyed at once."""
        self._watchdog.permit(word)
        if word.action is Action.OFF and self.driver.active:
            self._switch_off(word.reason)
        elif word.action is Action.OFF:
            self.reason = word.reason

    def relax(self, reason: str) -> None:
        """Slacken the tendons in the steps to come, then torque off."""
        self._watchdog.relax(reason)

    def step(self, now: int) -> Cycle:
        """One bus cycle; raises PortError where the port has gone."""
        self._count(now)
        if self.driver.active:
            self._command(now)
        cycle = self.driver.cycle()
        self._durations.append(cycle.duration)
        if self.action is Action.PASS and self.commanded != self._offered:
            self.commanded, self.written = self._offered, cycle.written
        return cycle

    def _command(self, now: int) -> None:
        for fault in (self.driver.faults() + self.silent())[:1]:
            self.relax(fault)
        gated = self._watchdog.step(now)
        self.action, self.reason = self._watchdog.action, self._watchdog.reason
        if gated.torque and gated.action is Action.HOLD:
            self.driver.hold()  # also where a slack tendon lies beyond the range of commands
        elif gated.torque:
            self.driver.command(gated.angle)
        else:
            self._switch_off(self.reason)

    def stop(self) -> TorqueOff:
        """Slacken the tendons, then torque off, read back; blocks for as long as the ramp takes."""
        self.driver.bus.port.is_using = False  # an interrupt may have left a question unanswered
        ramp = float(self.driver.goals().max()) / self._settings.gate.relax_rate
        if self.driver.active and ramp > self.period:
            off = self.driver.relax(ramp, self.period, self._sleep)
        else:
            off = self.driver.torque_off()
        if self.action is not Action.OFF:
            self.action, self.reason = Action.OFF, "stopped"
        return off

    def pace(self, now: int) -> BusPace:
        """How the bus has kept its rate since the last call."""
        times, self._durations = self._durations, []
        passed = 0.0 if self._looked is None else (now - self._looked) / SECOND
        self._looked = now
        if not times or passed <= 0.0:
            return BusPace(0.0, 0.0, 0.0, self.overruns)
        return BusPace(len(times) / passed, sum(times) / len(times), max(times), self.overruns)

    @property
    def letting_go(self) -> str:
        """Why the legs are slack, or become so, by its own rule and no word; or ""."""
        return self._watchdog.letting_go

    def silent(self) -> list[str]:
        """Servos that have not answered for too long, one line each."""
        limit = self._settings.timing.servo_silent
        ages = [(joint.name, self.driver.silent_for(joint.leg)) for joint in self.driver.joints]
        return [
            f"{name}: no answer for {age:.2f} s, limit {limit:g} s"
            for name, age in ages
            if age > limit
        ]

    def _switch_off(self, reason: str) -> None:
        off = self.driver.torque_off()
        words = "torque off" if off.complete else "torque NOT off: " + "; ".join(off.reasons)
        self.action, self.reason = Action.OFF, f"{words}, after: {reason}"

    def _count(self, now: int) -> None:
        late = self._stepped is not None and now - self._stepped > LATE * self.period * SECOND
        self.overruns += late
        self._stepped = now


def measured(stamp: int, cycle: Cycle, tendon_stall: Array) -> MeasuredJoints | None:
    """What a cycle measured, or None unless every servo answered.

    The torque is the servo's estimate: its load, a share of the stall torque (4,), N m on the
    tendon's angle.
    """
    readings = [reading for reading in cycle.readings if reading is not None]
    if len(readings) < len(LEGS):
        return None
    angle, rate, load = (np.array([getattr(r, n) for r in readings]) for n in _MEASURED)
    return MeasuredJoints(stamp, angle, rate, load * tendon_stall)


_MEASURED = ("angle", "rate", "load")
