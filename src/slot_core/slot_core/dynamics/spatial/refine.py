"""Correction of the hinges that restores the chain's order where bending and twist meet.

Let kappa = kappa0 + eta be the strains in the frame (t, d, b) of a rod whose natural shape is
planar, kappa0 = (0, c, 0), with the twist k1 and the index b for the part across t; mu = B eta is
the moment. Inside the rod the chain's segments lie h^2 sigma away from the frames of the curve, and
its nodes -h^2/12 (eta_b x t) from the curve itself (c_k of `rod.py` does that along t). A hinge of
weight w then has the moment of the curve if its natural rotation vector is psi0 + delta with

    delta / (w h^2) = (kappa x (eta' + 3 kappa0')) / 24 + z' + kappa x z
                      + B^-1 { ((eta' + 2 kappa0') / 12 + z) x mu - t (eta_b . f) / 12
                               - kappa x (kappa x mu) / 24 },
    z = k1 t x (kappa0 - eta_b) / 24,      f = t x (mu' + kappa x mu).

At an end the weights 3/8, 7/6, 23/24 of Gregory's rule turn the first segments otherwise than the
curve: the frames halfway through the first hinges are off by h (E eta + N kappa0), E = 3/16, -1/24,
1/48, N = 1/4, 0, 0, and all behind them by 5/96 h^2 kappa0 x eta, and z begins there:

    delta += w h B^-1 ((E eta + N kappa0) x mu),      delta_0 += h^2 (z - 5/96 kappa0 x eta).

The same holds at the tip with the signs reversed. All of it is zero for bending in one plane.
Derivatives along the arc are differences between neighbouring hinges, one-sided at the ends. The
correction is taken at the iterate and left out of the tangent.
"""

# mypy: disable-error-code="no-untyped-def"

from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array
from slot_core.compiled import helper
from slot_core.dynamics.algebra import (
    add,
    cross,
    minus,
    plus,
    put,
    row,
    scaled,
)


class Refinement(NamedTuple):
    """Numbers and scratch arrays of the correction for n hinges at equal steps of arc length."""

    extent: Array  # (n,) m, weights w
    curvature: Array  # (n,) 1/m, c
    slope: Array  # (n,) 1/m^2, c'
    tilt: Array  # (n, 2) m, h E and h N; of the other sign at the tip
    step: float  # m, h
    strain: Array  # (n, 3) 1/m, eta
    moment: Array  # (n, 3) N m, mu
    shift: Array  # (n, 3) 1/m^2, z
    delta: Array  # (n, 3) N m, delta times the hinge's stiffness; zero where not `active`
    active: bool


def tilts(hinges: int) -> Array:
    """(n, 2) E and N of n hinges at equal steps; zero for fewer than six, whose ends overlap."""
    tilt = np.zeros((hinges, 2))
    if hinges >= 6:
        tilt[:3, 0], tilt[0, 1] = (3 / 16, -1 / 24, 1 / 48), 1 / 4
        tilt -= tilt[::-1]
    return tilt


@helper
def refine(r, s, rod):
    """Write r.delta from the rotation vectors in s (`strain.py`)."""
    n = r.extent.size
    if not r.active:
        return
    for k in range(n):
        psi = (s.twist[k], s.turn[k] - rod.rest_angle[k], s.side[k])
        eta = scaled(1.0 / r.extent[k], psi)
        twist = eta[0]
        put(r.moment, k, _stiffened(rod, k, psi))
        put(r.strain, k, eta)
        across = (
            twist * eta[2] / 24.0,
            twist * (r.curvature[k] - eta[1]) / 24.0,
        )
        put(r.shift, k, (0.0 * twist, across[0], across[1]))
    for k in range(n):
        put(r.delta, k, _delta(r, rod, k))
    square = r.step**2
    put(r.delta, 0, plus(row(r.delta, 0), square, _begin(r, rod, 0)))
    put(
        r.delta,
        n - 1,
        plus(row(r.delta, n - 1), -square, _begin(r, rod, n - 1)),
    )


@helper
def _stiffened(rod, k, v):
    """B v: the moment of hinge k, N m, for a rotation vector v, times 1 / weight for a strain."""
    return rod.torsion[k] * v[0], rod.bending[k] * v[1], rod.lateral[k] * v[2]


@helper
def _rate(r, a, k):
    """Derivative of the rows of a along the arc at hinge k."""
    before = max(k - 1, 0)
    behind = min(k + 1, r.extent.size - 1)
    per_length = 1.0 / ((behind - before) * r.step)
    return scaled(per_length, minus(row(a, behind), row(a, before)))


@helper
def _delta(r, rod, k):
    """Correction of hinge k but for the jump at the ends, times the hinge's stiffness."""
    square, slope, c = r.step**2, r.slope[k], r.curvature[k]
    eta, mu, z = row(r.strain, k), row(r.moment, k), row(r.shift, k)
    kappa = (eta[0], eta[1] + c, eta[2])
    rate = _rate(r, r.strain, k)
    g = add(_rate(r, r.moment, k), cross(kappa, mu))
    spread = plus(z, 1.0 / 12.0, (rate[0], rate[1] + 2.0 * slope, rate[2]))
    e, n = r.tilt[k, 0], r.tilt[k, 1]
    tilt = (e * eta[0], e * eta[1] + n * c, e * eta[2])
    m = cross(plus(tilt, square, spread), mu)
    m = plus(m, -square / 24.0, cross(kappa, cross(kappa, mu)))
    twist = square * (eta[2] * g[1] - eta[1] * g[2]) / 12.0
    v = cross(
        kappa, plus(z, 1.0 / 24.0, (rate[0], rate[1] + 3.0 * slope, rate[2]))
    )
    v = add(v, _rate(r, r.shift, k))
    scale = square * r.extent[k]
    return (
        m[0] - twist + scale * rod.torsion[k] * v[0],
        m[1] + scale * rod.bending[k] * v[1],
        m[2] + scale * rod.lateral[k] * v[2],
    )


@helper
def _begin(r, rod, k):
    """Jump z - 5/96 kappa0 x eta at an end, times the hinge's stiffness over h^2."""
    eta, z = row(r.strain, k), row(r.shift, k)
    c = 5.0 / 96.0 * r.curvature[k]
    return _stiffened(rod, k, minus(z, (c * eta[2], 0.0 * c, -c * eta[0])))
