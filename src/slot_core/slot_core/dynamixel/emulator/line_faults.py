"""Noise and faults in the answers of an emulated servo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class LineFaults:
    """Faults in the answers of one servo."""

    silent: bool = False  # no answers
    corrupt: float = 0.0  # fraction of its answers that are corrupted
    late: float = 0.0  # s, additional delay of its answers


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with one random bit inverted, an error that the CRC always detects."""
    where, bit = rng.integers(len(data)), rng.integers(8)
    return data[:where] + bytes([data[where] ^ (1 << bit)]) + data[where + 1 :]
