"""Free numbers of a pattern: the symmetry of a stride gives the rest of its coefficients.

A pattern has 4 x 5 coefficients (deg), legs FL FR RL RR, columns m, c1, s1, c2, s2. Symmetries of
the robot, each together with half a stride:

    forward   left and right exchanged: FR = FL, RR = RL half a stride later; 10 numbers
    lateral   the forward pattern reflected at the diagonal: FR and RL exchanged
    turn      half a turn of the robot: RR = FL, RL = FR half a stride later; 10 numbers
    steering  antisymmetric where forward is symmetric, so that it only turns the robot; 10 numbers
"""

import numpy as np

from slot_core.arrays import Array
from slot_core.gait.gait import (
    FRONT_REAR,
    HALF_STRIDE_LATER,
    LEFT_RIGHT,
    TORSO_MOTION,
    FourHarmonics,
)

# legs after the reflection at the diagonal through FL and RR
DIAGONAL = [0, 2, 1, 3]
NUMBERS = {"forward": 10, "turn": 10}
FREE_LEGS = {"forward": (0, 2), "turn": (0, 1)}
"""Rows of a pattern that are its numbers."""
# Symmetry of the motion of each pattern: legs exchanged, and the sway that changes its sign.
EXCHANGED = {"forward": LEFT_RIGHT, "lateral": FRONT_REAR, "turn": [3, 2, 1, 0]}
REVERSED = {
    "forward": {"roll", "v_y"},
    "lateral": {"pitch", "v_x"},
    "turn": {"roll", "pitch", "v_x", "v_y"},
}


def forward(x: Array) -> Array:
    """Coefficients (4, 5) of the numbers (10,): FL's, then RL's."""
    front, rear = x[:5], x[5:]
    return np.stack(
        [front, front * HALF_STRIDE_LATER, rear, rear * HALF_STRIDE_LATER]
    )


def steering(x: Array) -> Array:
    """Coefficients (4, 5) of the numbers (10,): antisymmetric under forward's symmetry."""
    front, rear = x[:5], x[5:]
    return np.stack(
        [front, -front * HALF_STRIDE_LATER, rear, -rear * HALF_STRIDE_LATER]
    )


def lateral(pattern: Array) -> Array:
    """Lateral pattern (4, 5), to the left, of a forward pattern (4, 5)."""
    return np.asarray(pattern[DIAGONAL])


def turn(x: Array) -> Array:
    """Coefficients (4, 5) of the numbers (10,): FL's, then FR's."""
    left, right = x[:5], x[5:]
    return np.stack(
        [left, right, right * HALF_STRIDE_LATER, left * HALF_STRIDE_LATER]
    )


def numbers(kind: str, pattern: Array) -> Array:
    """Numbers of the pattern of a kind ("forward" or "turn") nearest to a pattern (4, 5)."""
    image = pattern[EXCHANGED[kind]] * HALF_STRIDE_LATER
    return np.concatenate((pattern + image)[list(FREE_LEGS[kind])]) / 2


def symmetrised(name: str, table: Array) -> Array:
    """Table (9, 5) of normal forces and sway; terms that the symmetry excludes become zero."""
    sign = [[-1.0 if key in REVERSED[name] else 1.0] for key in TORSO_MOTION]
    exchanged = np.vstack([table[:4][EXCHANGED[name]], sign * table[4:]])
    image = exchanged * HALF_STRIDE_LATER
    return np.asarray((table + image) / 2)


def rows(pattern: Array) -> FourHarmonics:
    """A pattern (4, 5) as the tuples of a settings class."""
    fl, fr, rl, rr = (tuple(float(value) for value in row) for row in pattern)
    return (fl, fr, rl, rr)  # type: ignore[return-value]
