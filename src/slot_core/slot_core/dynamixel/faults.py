"""Faults of the emulated bus: what, at which servo, when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slot_core.config import choice, quantity
from slot_core.dynamixel.settings import LEGS

KINDS = (
    "silent", "corrupt", "late", "wrong_id", "overload", "overheating", "undervoltage",
    "watchdog", "unplugged",
)  # fmt: skip
ALL = "all"


@dataclass(frozen=True)
class BusFault:
    """One fault; a scene may hold several by name."""

    kind: str = choice("what goes wrong", *KINDS)
    leg: str = choice("at which servo", ALL, *LEGS)
    time: float = quantity("of its begin", "s", 0.0, 1e6)
    duration: float = quantity("how long; 0: for good", "s", 0.0, 1e6)
    value: float = quantity(
        "corrupt: share of damaged answers; late: delay, s; wrong_id: the id;"
        " overheating: degC; undervoltage: V; else unused",
        "", 0.0, 1e4,
    )  # fmt: skip

    def at(self, time: float) -> bool:
        """Whether it is there at a time (s)."""
        return self.time <= time and (self.duration == 0.0 or time < self.time + self.duration)


@dataclass
class LineFaults:
    """What is wrong now with the answers of one servo."""

    silent: bool = False
    corrupt: float = 0.0  # share of its answers
    late: float = 0.0  # s


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with one bit inverted: noise that a CRC is sure to find."""
    where, bit = rng.integers(len(data)), rng.integers(8)
    return data[:where] + bytes([data[where] ^ (1 << bit)]) + data[where + 1 :]
