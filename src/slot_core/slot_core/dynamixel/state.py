"""Results of the driver: readings, servo health, bus cycles."""

from __future__ import annotations

from dataclasses import dataclass

from slot_core.hardware_error import hardware_errors
from slot_core.robot import Array


@dataclass(frozen=True)
class ServoReading:
    """Measurement of one servo, converted to its tendon: positive when pulling."""

    time: float  # s, when the answer was complete
    angle: float  # rad
    rate: float  # rad/s
    load: float  # fraction of the stall torque, estimated by the servo from its output
    alert: bool  # the hardware error status is not 0


@dataclass(frozen=True)
class Health:
    """Newest state of one servo; None: not read yet."""

    leg: str
    id: int
    last_answer: float | None = None  # s, of the driver's clock
    torque: bool | None = None  # whether it is on
    hardware_error: int | None = None  # bits of HardwareError
    watchdog: int | None = None  # value of Bus Watchdog, in 20 ms; -1: it has tripped
    voltage: float | None = None  # V
    temperature: float | None = None  # degC
    error_rate: float = 0.0  # fraction of the last exchanges that failed

    def faults(self, armed: bool) -> list[str]:
        """One line for each fault; `armed`: torque should be on."""
        name, found = f"servo {self.leg} (id {self.id})", []
        if self.hardware_error:
            found.append(f"{name}: hardware error: {hardware_errors(self.hardware_error)}")
        if self.watchdog is not None and self.watchdog < 0:
            found.append(f"{name}: stopped by its bus watchdog")
        if armed and self.torque is False:
            found.append(f"{name}: torque is off")
        return found


@dataclass(frozen=True)
class JointReading:
    """Tendon angles (rad), rates and servo torques (N m), each (4,), at `stamp` (ns)."""

    stamp: int
    angle: Array
    rate: Array
    torque: Array


@dataclass(frozen=True)
class Cycle:
    """Result of one bus cycle, in the order FL FR RL RR; times in s of the driver's clock."""

    duration: float  # s
    written: float  # when the goals had been written to the port
    readings: tuple[ServoReading | None, ...]  # None: no valid answer
    duty: Array | None  # (4,) of the host PID; None in position mode

    @property
    def complete(self) -> bool:
        """Whether every servo answered."""
        return None not in self.readings


@dataclass(frozen=True)
class TorqueOff:
    """Servos whose torque was read back as off, FL FR RL RR, and the reasons of the others."""

    confirmed: tuple[bool, ...]
    reasons: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Whether the torque of all servos is off."""
        return all(self.confirmed)
