"""A brand of servos in one file: in memory, with a lag and nothing else.

A line with `make_brand` in `BRANDS` of slot_core/servos/registry.py makes it known. The servos answer in
their own process alone: `EmulatedServos.serve`, a device for a driver in another one, is left out.
"""

import dataclasses
import math
import time

import numpy as np

from slot_core.config import text
from slot_core.dynamics.servo import read_servo
from slot_core.robot import LEGS, read_robot
from slot_core.servos.brand import Brand
from slot_core.servos.servo_bus import (
    BusFacts,
    Cycle,
    PortError,
    RefusedError,
    ServoReading,
    ServoStatus,
    TorqueOff,
)

LAG = 0.02  # s


@dataclasses.dataclass(frozen=True)
class IdealPort:
    """Where the servos are."""

    port: str = text("any name")


@dataclasses.dataclass(frozen=True)
class IdealSettings:
    """Settings of the brand."""

    bus: IdealPort


class IdealServos:
    """Servos without limit of speed or torque, and without watchdog: `EmulatedServos`."""

    def __init__(self, angles=(0.0,) * 4, voltage=11.1):
        self.angle, self.voltage = np.array(angles), voltage
        self.goal, self.torque = self.angle.copy(), np.zeros(4, dtype=bool)
        self.stall = read_servo().tendon_stall(voltage)  # N m
        self.load = np.zeros(4)  # share of it
        self.silent = set()  # the legs that do not answer
        self.unplugged = False

    def advance(self, dt, torques=(0.0,) * 4):
        """Advance by dt, s, under torques of the tendons, N m."""
        self.load = np.asarray(torques) / self.stall
        share = np.where(self.torque, dt / (dt + LAG), 0.0)
        self.angle = self.angle + share * (self.goal - self.angle)
        return self.angle

    def angles(self):
        """Present angles of the tendons, rad."""
        return self.angle

    def powered(self):
        """Legs whose servos have torque on."""
        return tuple(leg for leg, on in zip(LEGS, self.torque) if on)

    def driven(self):
        """Whether torque is on with a goal away from where a servo is."""
        return bool((self.torque & (self.goal != self.angle)).any())

    def watchdog_left(self):
        """Time until a watchdog stops them: there is none."""
        return math.inf

    def set_fault(self, fault, on):
        """Unplug the bus, or let servos be silent; for ever."""
        if fault.kind == "unplugged":
            self.unplugged = True
        else:
            self.silent |= {*fault.legs}

    def connect(self, clock):
        """Bus to these servos."""
        return IdealBus(self, clock)


class IdealBus:
    """The bus of these servos: `ServoBus`."""

    def __init__(self, servos, clock):
        self.servos, self.clock, self.active = servos, clock, False
        self.facts = BusFacts(
            "ideal", "/dev/null", 0.0, read_robot().tendon.angle_max, math.inf
        )
        self.health = tuple(
            ServoStatus(leg, k + 1) for k, leg in enumerate(LEGS)
        )

    def configure(self):
        """Refuse servos that do not answer; torque is off then."""
        self._require_port()
        if not (off := self.torque_off()).complete:
            raise RefusedError(list(off.reasons))
        self._update()
        return tuple(f"{servo.leg} id {servo.id}" for servo in self.health)

    def activate(self):
        """Torque on, without motion."""
        if self.active:
            raise RefusedError(["torque is on already"])
        self.servos.goal, self.active = self.servos.angle.copy(), True
        self.servos.torque[:] = True
        self._update()

    def command(self, angles):
        """Set the goals, rad."""
        goal = np.asarray(angles, dtype=float)
        inside = (goal >= self.facts.low) & (goal <= self.facts.high)
        if not self.active or goal.shape != (len(LEGS),) or not inside.all():
            raise ValueError(
                f"{goal} rad: torque is off, or outside of the range"
            )
        self.servos.goal = goal.copy()

    def goals(self):
        """Goals, rad."""
        return self.servos.goal.copy()

    def cycle(self):
        """Readings of the servos that answer."""
        self._require_port()
        self._update()
        now = self.clock()
        readings = (
            None
            if leg in self.servos.silent
            else ServoReading(now, angle, 0.0, load)
            for leg, angle, load in zip(
                LEGS, self.servos.angle, self.servos.load
            )
        )
        return Cycle(0.0, now, tuple(readings))

    def torque_off(self):
        """Switch torque off; servos that do not answer are named."""
        self.active = False
        if not self.servos.unplugged:
            self.servos.torque[:] = False
            self._update()
        lost = LEGS if self.servos.unplugged else self.servos.silent
        missing = tuple(
            f"{s.name}: no answer" for s in self.health if s.leg in lost
        )
        return TorqueOff(tuple(leg not in lost for leg in LEGS), missing)

    def close(self):
        """Close the port: there is none."""

    def _require_port(self):
        if self.servos.unplugged:
            raise PortError("/dev/null: the port has disappeared")

    def _update(self):
        found = {"last_answer": self.clock(), "voltage": self.servos.voltage}
        self.health = tuple(
            s
            if s.leg in self.servos.silent
            else dataclasses.replace(s, torque=bool(on), **found)
            for s, on in zip(self.health, self.servos.torque)
        )


def make_brand(servos=None, clock=time.monotonic):
    """The brand; a driver of its own drives `servos` on `clock` (s)."""

    def read_settings():
        return IdealSettings(IdealPort("/dev/null"))

    return Brand(
        read_settings, lambda settings: IdealBus(servos, clock), IdealServos
    )
