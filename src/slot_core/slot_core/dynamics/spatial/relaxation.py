"""Relaxation of the legs' material: two Maxwell branches beside the springs of the strains.

A branch has the share g of the modulus and the relaxation time T. With a strain e of a segment
(twist, bending in the plane and sideways, extension) and the strain a of the branch's damper,

    stress / modulus = e + beta de/dt + sum g (e - a),      da/dt = (e - a) / T.

The theta scheme's stage value of a is (a_n + r e) / (1 + r), r = theta h / T, so that in a step

    stress / modulus = (1 + A) e + beta de/dt + lag,
    A = sum g / (1 + r),      lag = -sum a_n g / (1 + r).

For slow loads the modulus is Young's, for fast ones (1 + sum g) times as large.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from slot_core.compiled import helper


@helper
def remember(s, relaxation, memory, tau):
    """Write A and the lag (N-1, 4) of a step with the stage at tau (s) into the segments s.

    relaxation (2, 2): shares and times; memory (N-1 or 0, 4, 2): the strains a.
    """
    for k in range(memory.shape[0]):
        for b in range(2):
            part = relaxation[0, b] / (1.0 + tau / relaxation[1, b])
            for c in range(4):
                held = part * memory[k, c, b]
                s.lag[k, c] = -held if b == 0 else s.lag[k, c] - held
    s.firm[0] = 0.0
    for b in range(2):
        s.firm[0] += relaxation[0, b] / (1.0 + tau / relaxation[1, b])


@helper
def relax(s, rod, memory, h, theta):
    """Advance the strains a over a step from the strains at its stage."""
    for k in range(memory.shape[0]):
        for b in range(2):
            share = h / (rod.relaxation[1, b] + theta * h)
            memory[k, 0, b] += share * (s.twist[k] - memory[k, 0, b])
            memory[k, 1, b] += share * (s.turn[k] - rod.rest_angle[k] - memory[k, 1, b])
            memory[k, 2, b] += share * (s.side[k] - memory[k, 2, b])
            memory[k, 3, b] += share * (s.extension[k] - memory[k, 3, b])
