"""What noise and faults do to the answers of an emulated servo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
