"""Reports of a servo bus: its facts, the servos' status, bus cycles, torque off."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slot_core.faults import hardware_errors
from slot_core.joint_reading import JointReading
from slot_core.robot import Array


@dataclass(frozen=True)
class BusFacts:
    """Properties of a bus that do not change while it runs."""

    brand: str  # as in BRANDS, and name of the settings in `config/`
    port: str  # device, which may not be there yet
    low: float  # rad, smallest tendon angle that every servo accepts
    high: float  # rad, largest one
    watchdog: (
        float  # s without a bus cycle after which a servo stops by itself; inf: never
    )


@dataclass(frozen=True)
class ServoReading:
    """Measurement of one servo, converted to its tendon: positive when pulling."""

    time: float  # s, when the answer was complete
    angle: float  # rad
    rate: float  # rad/s
    load: float  # share of the stall torque, as the servo estimates it


@dataclass(frozen=True)
class ServoStatus:
    """Newest state of one servo; None: not read yet."""

    leg: str
    id: int  # on the bus
    last_answer: float | None = None  # s, of the bus's clock
    torque: bool | None = None  # whether it is on
    hardware_error: int | None = None  # bits of HardwareError
    stopped: bool = False  # by its own watchdog
    voltage: float | None = None  # V
    temperature: float | None = None  # degC
    error_rate: float = 0.0  # share of the last exchanges that failed

    @property
    def name(self) -> str:
        """Name of the servo in messages."""
        return f"servo {self.leg} (id {self.id})"

    def silence(self, now: float) -> float:
        """Time since the last answer at `now`, s; inf if there was none."""
        return math.inf if self.last_answer is None else now - self.last_answer

    def faults(self, armed: bool) -> list[str]:
        """One line for each fault; `armed`: torque should be on."""
        found = []
        if self.hardware_error:
            found.append(
                f"{self.name}: hardware error: {hardware_errors(self.hardware_error)}"
            )
        if self.stopped:
            found.append(f"{self.name}: stopped by its bus watchdog")
        if armed and self.torque is False:
            found.append(f"{self.name}: torque is off")
        return found


@dataclass(frozen=True)
class Cycle:
    """Result of one bus cycle, in the order FL FR RL RR; times in s of the bus's clock."""

    duration: float  # s
    written: float  # when the goals had been written
    readings: tuple[ServoReading | None, ...]  # None: no valid answer

    @property
    def complete(self) -> bool:
        """Whether every servo answered."""
        return None not in self.readings

    def joints(self, stamp: int, tendon_stall: Array) -> JointReading | None:
        """Joints at `stamp` (ns); None unless every servo answered.

        tendon_stall: (4,) N m, stall torques at the tendon, of which the load is a share.
        """
        found = [reading for reading in self.readings if reading is not None]
        if not self.complete:
            return None
        angle, rate, load = np.array([(r.angle, r.rate, r.load) for r in found]).T
        return JointReading(stamp, angle, rate, load * tendon_stall)


@dataclass(frozen=True)
class TorqueOff:
    """Servos whose torque was read back as off, FL FR RL RR, and the reasons of the others."""

    confirmed: tuple[bool, ...]
    reasons: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Whether the torque of all servos is off."""
        return all(self.confirmed)
