"""The contract of a servo driver: its bus, the reports of the bus and its errors.

Another brand implements `ServoBus` and enters the registry. Messages of errors name the servo and
the cause.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import Clock
from slot_core.faults import hardware_errors


@dataclass(frozen=True)
class JointReading:
    """Tendon angles (rad), rates (rad/s) and servo torques (N m), each (4,), at `stamp` (ns)."""

    stamp: int
    angle: Array
    rate: Array
    torque: Array


class ServoError(Exception):
    """Base class of the errors of a servo bus."""


class PortError(ServoError):
    """The port cannot be opened or set up, or has disappeared (unplugged)."""


class RefusedError(ServoError):
    """An action was refused because of the servos' state or set-up; `reasons`: one line each."""

    def __init__(self, reasons: list[str]) -> None:
        super().__init__("; ".join(reasons))
        self.reasons = tuple(reasons)


@dataclass(frozen=True)
class BusFacts:
    """Properties of a bus that do not change while it runs."""

    brand: str  # as in BRANDS, and name of the settings in `config/`
    port: str  # device, which may not be there yet
    low: float  # rad, smallest tendon angle that every servo accepts
    high: float  # rad, largest one
    # s without a bus cycle after which a servo stops by itself; inf: never
    watchdog: float


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
        found = [r for r in self.readings if r is not None]
        if not self.complete:
            return None
        angle, rate, load = np.array(
            [(r.angle, r.rate, r.load) for r in found]
        ).T
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


class ServoBus(Protocol):
    """Driver of the four servos: legs in the order of LEGS, angles of the tendons in rad.

    It starts closed, with torque unknown, and is used by one thread. It waits for answers only for
    a limited time: a servo that does not answer has no reading, and its `last_answer` stays.
    """

    facts: BusFacts
    clock: Clock  # s, of all times that the bus reports
    active: bool  # whether the bus has switched torque on and not off
    # of each servo; torque also after `activate`, `torque_off`
    health: tuple[ServoStatus, ...]

    def configure(self) -> tuple[str, ...]:
        """Open the port and check every servo against the settings; returns a line for each.

        Raises PortError, and RefusedError with all reasons, then with all torque off.
        """

    def activate(self) -> None:
        """Torque on without motion: the goals become the present angles.

        Arms the servos' own watchdogs first, if they have any. Raises RefusedError with all torque
        off, and where torque is on already.
        """

    def command(self, angles: Sequence[float] | Array) -> None:
        """Set the goals (4,), rad, that the next cycles write.

        Raises ValueError for angles outside of `facts`, and with torque off; the goals stay.
        """

    def goals(self) -> Array:
        """Goals (4,), rad: of the last command, or from `activate`."""

    def cycle(self) -> Cycle:
        """Exchange with all servos: goals out if active, readings in; raises ServoError."""

    def torque_off(self) -> TorqueOff:
        """Switch all torque off and read it back, also after an interrupted cycle; never raises."""

    def close(self) -> None:
        """Close the port; torque stays as it is. May be called again."""


@runtime_checkable
class ServoMaintenance(Protocol):
    """Optional services of a bus for one servo with torque off, beside ServoBus; raise ServoError."""

    def reboot(self, leg: str) -> None:
        """Restart a servo, as after a hardware error; it does not answer meanwhile."""

    def zero(self, leg: str, sleep: Callable[[float], None]) -> str:
        """Set the zero: the tendon is relaxed at the present angle, also in `config/`; returns a line.

        sleep: waits for a time (s). Raises ConfigError where the zero is not possible.
        """
