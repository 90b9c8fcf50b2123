"""Moments of a rectangular section."""

import numpy as np

from slot_core.arrays import Array
from slot_core.elementary import exp

TERMS = 21  # of the series; the first neglected one is below 1e-16 of the sum


def second_moment(width: float | Array, thickness: float | Array) -> Array:
    """b h^3 / 12, m^4: bending over the thickness h of a section of width b."""
    return np.asarray(width * np.square(thickness) * thickness / 12)


def torsion_constant(width: float | Array, thickness: float | Array) -> Array:
    """Saint-Venant's torsion constant of a rectangle of sides a >= b, m^4.

    J = a b^3 (1/3 - 64/pi^5 b/a sum tanh(n pi a / (2 b)) / n^5 over odd n) (Timoshenko and Goodier,
    Theory of Elasticity, art. 109).
    """
    a, b = np.maximum(width, thickness), np.minimum(width, thickness)
    n = 2.0 * np.arange(TERMS) + 1
    decay = exp(-np.pi * np.multiply.outer(a / b, n))
    tanh = (1.0 - decay) / (1.0 + decay)
    series = (tanh / (np.square(np.square(n)) * n)).sum(axis=-1)
    pi5 = np.square(np.square(np.pi)) * np.pi
    return np.asarray(
        a * b * np.square(b) * (1 / 3 - 64 / pi5 * b / a * series)
    )
