"""Commands to servos: the driver behind the gate, and what becomes of silence and faults.

    no command yet            HOLD: the servos stay where they were switched on
    a command                 PASS: the goals follow it, slewed
    silence > command_hold    HOLD
    silence > command_lost    RELAX: a ramp to slack, then torque off
    a fault of a servo        RELAX

RELAX stays until `start`. Times are those of a clock that never goes back, ns.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slot_core.control.command_gate import SECOND, Action, CommandGate
from slot_core.control.supervisor_settings import SupervisorSettings
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.state import Cycle, TorqueOff
from slot_core.robot import LEGS, Array

LATE = 1.5  # periods between two cycles that count as an overrun


@dataclass(frozen=True)
class MeasuredJoints:
    """Tendon angles (rad), rates and servo torques (N m), each (4,), at `stamp` (ns)."""

    stamp: int
    angle: Array
    rate: Array
    torque: Array


@dataclass(frozen=True)
class Pace:
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
        self._settings, self._gate, self._sleep = settings, CommandGate(settings.gate, limit), sleep
        self._heard: int | None = None  # time of the last good command
        self._relaxing = ""  # why
        self._stepped: int | None = None
        self._looked: int | None = None
        self._durations: list[float] = []

    def start(self) -> None:
        """Torque on without motion; raises RefusedError, and then all torque is off."""
        self.driver.activate()
        self._gate.engage(self.driver.goals())
        self._heard, self._relaxing, self._stepped = None, "", None
        self.action, self.reason = Action.HOLD, "no command yet"

    def offer(self, now: int, angle: Array) -> str:
        """Take tendon angles (4,), rad, as a whole; or refuse them and say why."""
        fault = self._gate.offer(angle)
        if not fault:
            self._heard = now
        return fault

    def relax(self, reason: str) -> None:
        """Slacken the tendons in the steps to come, then torque off."""
        self._relaxing = self._relaxing or reason

    def step(self, now: int) -> Cycle:
        """One bus cycle; raises PortError where the port has gone."""
        self._count(now)
        if self.driver.active:
            self.action, self.reason = self._decide(now)
            gated = self._gate.step(now, self.action, fast=True)
            if gated.torque:
                self.driver.command(gated.angle)
            else:
                self._switch_off()
        cycle = self.driver.cycle()
        self._durations.append(cycle.duration)
        return cycle

    def stop(self) -> TorqueOff:
        """Slacken the tendons, then torque off, read back; blocks for as long as the ramp takes."""
        self.driver.bus.port.is_using = False  # an interrupt may have left a question unanswered
        ramp = float(self.driver.goals().max()) / self._settings.gate.relax_rate
        if self.driver.active and ramp > self.period:
            off = self.driver.relax(ramp, self.period, self._sleep)
        else:
            off = self.driver.torque_off()
        self.action, self.reason = Action.OFF, "stopped"
        return off

    def pace(self, now: int) -> Pace:
        """How the bus has kept its rate since the last call."""
        times, self._durations = self._durations, []
        passed = 0.0 if self._looked is None else (now - self._looked) / SECOND
        self._looked = now
        if not times or passed <= 0.0:
            return Pace(0.0, 0.0, 0.0, self.overruns)
        return Pace(len(times) / passed, sum(times) / len(times), max(times), self.overruns)

    def silent(self) -> list[str]:
        """Servos that have not answered for too long, one line each."""
        limit = self._settings.timing.servo_silent
        ages = [(joint.name, self.driver.silent_for(joint.leg)) for joint in self.driver.joints]
        return [
            f"{name}: no answer for {age:.2f} s, limit {limit:g} s"
            for name, age in ages
            if age > limit
        ]

    def _decide(self, now: int) -> tuple[Action, str]:
        timing = self._settings.timing
        for fault in (self.driver.faults() + self.silent())[:1]:
            self.relax(fault)
        age = 0.0 if self._heard is None else (now - self._heard) / SECOND
        if age > timing.command_lost:
            self.relax(f"no command for {age:.2f} s, limit {timing.command_lost:g} s")
        if self._relaxing:
            return Action.RELAX, self._relaxing
        if self._heard is None:
            return Action.HOLD, "no command yet"
        if age > timing.command_hold:
            return Action.HOLD, f"no command for {age:.2f} s, limit {timing.command_hold:g} s"
        return Action.PASS, ""

    def _switch_off(self) -> None:
        off = self.driver.torque_off()
        words = "torque off" if off.complete else "torque NOT off: " + "; ".join(off.reasons)
        self.action, self.reason = Action.OFF, f"{words}, after: {self._relaxing}"

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
