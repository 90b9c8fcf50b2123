"""What the driver reports: readings, health, and what became of commands."""

from __future__ import annotations

from dataclasses import dataclass

from slot_core.dynamixel.checks import hardware_errors
from slot_core.robot import Array


@dataclass(frozen=True)
class ServoReading:
    """What a servo measured, as the tendon's: pulling is positive."""

    time: float  # s, of the clock, when the answer was complete
    angle: float  # rad
    rate: float  # rad/s
    load: float  # share of the stall torque, as the servo infers it from its output
    alert: bool


@dataclass(frozen=True)
class Health:
    """What is known of a servo; None: not read yet."""

    leg: str
    id: int
    last_answer: float | None = None  # s, of the clock
    torque: bool | None = None
    hardware_error: int | None = None
    watchdog: int | None = None  # in units of 20 ms; -1: it has stopped the servo
    voltage: float | None = None  # V
    temperature: float | None = None  # degC
    error_rate: float = 0.0  # of the exchanges within the window

    def faults(self, armed: bool) -> list[str]:
        """What is wrong, in words; `armed`: torque should be on."""
        name, found = f"servo {self.leg} (id {self.id})", []
        if self.hardware_error:
            found.append(f"{name}: hardware error: {hardware_errors(self.hardware_error)}")
        if self.watchdog is not None and self.watchdog < 0:
            found.append(f"{name}: stopped by its bus watchdog")
        if armed and self.torque is False:
            found.append(f"{name}: torque is off")
        return found


@dataclass(frozen=True)
class Verdict:
    """What became of a command."""

    accepted: bool
    reason: str = ""


@dataclass(frozen=True)
class Cycle:
    """One bus cycle, FL FR RL RR."""

    time: float  # s, of its end
    duration: float  # s
    written: float  # s, of the clock, when the goals had been handed to the port
    readings: tuple[ServoReading | None, ...]
    slewed: tuple[bool, ...]  # whether the goal was held back by the speed limit
    duty: Array | None  # of the host's loop, else None

    @property
    def complete(self) -> bool:
        """Whether every servo answered."""
        return None not in self.readings


@dataclass(frozen=True)
class TorqueOff:
    """Which servos have confirmed that their torque is off, FL FR RL RR; why others have not."""

    confirmed: tuple[bool, ...]
    reasons: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Whether all have."""
        return all(self.confirmed)
