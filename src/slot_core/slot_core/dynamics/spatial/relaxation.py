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

from slot_core.compiled import helper


@helper
def remember(s, relaxation, memory, tau):
    """Write A and the lag (N-1, 4) of a step with the stage at tau (s) into the segments s.

    relaxation (2, 2): shares and times; memory (N-1 or 0, 4, 2): the strains a.
    """
    first = relaxation[0, 0] / (1.0 + tau / relaxation[1, 0])
    second = relaxation[0, 1] / (1.0 + tau / relaxation[1, 1])
    s.firm[0] = first + second
    for k in range(memory.shape[0]):
        for c in range(4):
            s.lag[k, c] = -first * memory[k, c, 0] - second * memory[k, c, 1]


@helper
def relax(s, rod, memory, h, theta):
    """Advance the strains a over a step from the strains at its stage."""
    first = h / (rod.relaxation[1, 0] + theta * h)
    second = h / (rod.relaxation[1, 1] + theta * h)
    for k in range(memory.shape[0]):
        bend = s.turn[k] - rod.rest_angle[k]
        _approach(memory[k, 0], s.twist[k], first, second)
        _approach(memory[k, 1], bend, first, second)
        _approach(memory[k, 2], s.side[k], first, second)
        _approach(memory[k, 3], s.extension[k], first, second)


@helper
def _approach(a, strain, first, second):
    """Move both strains a (2,) towards a strain by a share each."""
    a[0] += first * (strain - a[0])
    a[1] += second * (strain - a[1])
