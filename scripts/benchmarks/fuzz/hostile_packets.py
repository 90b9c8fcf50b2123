"""Damaged packets to the emulated servos and to the driver: those of the benchmark `servo`."""

from __future__ import annotations

import numpy as np

from benchmarks.fuzz.outcomes import Outcomes
from benchmarks.servo import fuzz as servo

PARTS = (servo.fuzz_emulator, servo.fuzz_driver, servo.fuzz_instructions)


def fuzz(count: int, rng: np.random.Generator) -> Outcomes:
    """Count packets to each; accepted: a damaged one, or one that moved a servo."""
    tally = Outcomes()
    for part in PARTS:
        found = part(count, rng)
        moved = int(found.motion > 0.0)
        tally.tried += found.packets
        tally.exceptions += found.crashes
        tally.accepted += found.corruption + moved
        tally.refused += found.packets - found.crashes - found.corruption - found.intact
        tally.example = tally.example or found.crash
    return tally
