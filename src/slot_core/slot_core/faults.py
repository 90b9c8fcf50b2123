"""Faults of the simulated robot, planned by a scene or injected: what, at which leg, when.

Those of the bus happen to emulated servos, the others to the simulated legs.
"""

from __future__ import annotations

from dataclasses import dataclass

from slot_core.config import ConfigError, choice, quantity
from slot_core.robot import LEGS

ALL = "all"
SLACK, BROKEN, NAN = "tendon_slack", "tendon_broken", "nan"
BUS_KINDS = (
    "silent", "corrupt", "late", "wrong_id", "overload", "overheating", "undervoltage",
    "watchdog", "unplugged",
)  # fmt: skip
VALUES = {  # least, greatest and unit of the value; the least does something, as zero would not
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

    kind: str = choice("what goes wrong", *BUS_KINDS, SLACK, BROKEN, NAN)
    leg: str = choice("at which leg or servo", ALL, *LEGS)
    time: float = quantity("of its begin, after the robot's start", "s", 0.0, 1e6)
    duration: float = quantity("how long; 0: for good", "s", 0.0, 1e6)
    value: float = quantity(
        "corrupt: share of damaged answers; late: delay, s; wrong_id: the id; overheating: degC;"
        " undervoltage: V; tendon_slack: how much longer, m; else unused",
    )

    def __post_init__(self) -> None:
        """Raise ConfigError where the value cannot be that of the kind."""
        low, high, unit = VALUES.get(self.kind, (self.value, self.value, ""))
        if not low <= self.value <= high:
            raise ConfigError(f"value = {self.value}: outside [{low}, {high}] {unit}")

    @property
    def legs(self) -> tuple[str, ...]:
        """Which legs have it."""
        return legs_of(self.kind, self.leg)


def legs_of(kind: str, leg: str) -> tuple[str, ...]:
    """Which legs are meant by `leg`, all of them for the port of the servos."""
    return LEGS if leg == ALL or kind == "unplugged" else (leg,)


def refuse_without_bus(fault: Fault) -> None:
    """Raise ConfigError where it takes emulated servos to have a fault."""
    if fault.kind in BUS_KINDS:
        raise ConfigError(f"fault {fault.kind!r}: only the servos of hardware fake_bus can have it")
