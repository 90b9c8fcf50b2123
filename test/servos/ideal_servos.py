"""A brand of servos in one file: in memory, with a lag and nothing else."""

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
        # N m; a share
        self.stall, self.load = (
            read_servo().tendon_stall(voltage),
            np.zeros(4),
        )
        # the legs that do not answer
        self.silent, self.unplugged = (set(), False)

    def advance(self, dt, torques=(0.0,) * 4):
        self.load = np.asarray(torques) / self.stall
        share = np.where(self.torque, dt / (dt + LAG), 0.0)
        self.angle = self.angle + share * (self.goal - self.angle)
        return self.angle

    def angles(self):
        return self.angle

    def powered(self):
        return tuple(leg for leg, on in zip(LEGS, self.torque) if on)

    def driven(self):
        return bool((self.torque & (self.goal != self.angle)).any())

    def watchdog_left(self):
        return math.inf

    def set_fault(self, fault, on):
        if fault.kind == "unplugged":
            self.unplugged = True
        else:
            self.silent |= {*fault.legs}

    def connect(self, clock):
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
        self._require_port()
        if not (off := self.torque_off()).complete:
            raise RefusedError(list(off.reasons))
        self._update()
        return tuple(f"{servo.leg} id {servo.id}" for servo in self.health)

    def activate(self):
        if self.active:
            raise RefusedError(["torque is on already"])
        self.servos.goal, self.active = self.servos.angle.copy(), True
        self.servos.torque[:] = True
        self._update()

    def command(self, angles):
        goal = np.asarray(angles, dtype=float)
        inside = (goal >= self.facts.low) & (goal <= self.facts.high)
        if not self.active or goal.shape != (len(LEGS),) or not inside.all():
            raise ValueError(
                f"{goal} rad: torque is off, or outside of the range"
            )
        self.servos.goal = goal.copy()

    def goals(self):
        return self.servos.goal.copy()

    def cycle(self):
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
        pass

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
