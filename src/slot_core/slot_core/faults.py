"""Faults of the simulated robot, planned or injected, and hardware errors that servos report.

Faults of BUS_KINDS act on emulated servos, the others on the simulated legs.
"""

import enum
from dataclasses import dataclass

from slot_core.config import ConfigError, choice, quantity
from slot_core.names import LEGS

ALL_LEGS = "all"
SLACK, BROKEN, NAN = "tendon_slack", "tendon_broken", "nan"
BUS_KINDS = (
    "silent",
    "corrupt",
    "late",
    "wrong_id",
    "overload",
    "overheating",
    "undervoltage",
    "watchdog",
    "unplugged",
)
KINDS = (*BUS_KINDS, SLACK, BROKEN, NAN)
VALUE_RANGES = {  # minimum, maximum and unit of the value; at the minimum the fault has an effect
    "corrupt": (1e-3, 1.0, "of the answers"),
    "late": (1e-3, 10.0, "s"),
    "wrong_id": (0.0, 252.0, "as an id"),
    "overheating": (30.0, 200.0, "degC"),
    "undervoltage": (0.0, 16.0, "V"),
    SLACK: (1e-4, 0.1, "m"),
}


@dataclass(frozen=True)
class Fault:
    """One fault; a scene may hold several by name."""

    kind: str = choice("kind of the fault", *KINDS)
    leg: str = choice("leg or servo that has the fault", ALL_LEGS, *LEGS)
    time: float = quantity("start time after the robot's start", "s", 0.0, 1e6)
    duration: float = quantity("duration; 0: permanent", "s", 0.0, 1e6)
    value: float = quantity(
        "corrupt: share of damaged answers; late: delay, s; wrong_id: the id; overheating: degC;"
        " undervoltage: V; tendon_slack: additional slack, m; else unused",
    )

    def __post_init__(self) -> None:
        """Raise ConfigError if the value is outside the range of the kind."""
        low, high, unit = VALUE_RANGES.get(
            self.kind, (self.value, self.value, "")
        )
        if not low <= self.value <= high:
            raise ConfigError(
                f"value = {self.value}: outside [{low}, {high}] {unit}"
            )

    @property
    def legs(self) -> tuple[str, ...]:
        """Names of the legs that have the fault."""
        return legs_of(self.kind, self.leg)


def legs_of(kind: str, leg: str) -> tuple[str, ...]:
    """Names of the legs that a fault of `kind` at `leg` affects; `unplugged` affects all servos."""
    return LEGS if leg == ALL_LEGS or kind == "unplugged" else (leg,)


def require_simulated_legs(fault: Fault) -> None:
    """Raise ConfigError for a fault that requires emulated servos."""
    if fault.kind in BUS_KINDS:
        raise ConfigError(
            f"fault {fault.kind!r}: only the servos of hardware fake_bus can have it"
        )


class HardwareError(enum.IntFlag):
    """Bits of Hardware Error Status; the same bits of Shutdown select which switch torque off.

    Another brand of servos maps its own errors onto these. Source: ROBOTIS e-manual, XL430-W250,
    "Hardware Error Status".
    """

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    MOTOR_ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20


HARDWARE_ERROR_BITS = sum(HardwareError)  # all of them


def hardware_errors(bits: int) -> str:
    """Names of the bits set in a hardware error status, or "none"."""
    found = [
        str(error.name).lower().replace("_", " ")
        for error in HardwareError
        if bits & error
    ] + [f"bit {k}" for k in range(8) if (bits & ~HARDWARE_ERROR_BITS) >> k & 1]
    return ", ".join(found) or "none"
