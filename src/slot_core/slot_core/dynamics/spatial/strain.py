"""Strains of a spatial rod of stretch, bending in both planes and twist, without shear.

Nodes r_0 (clamp) ... r_{N-1} (tip); segment k runs from node k to k+1 and has a frame of unit
vectors: t along it, the director d across the leg's width, and b = t x d. At node k, the hinge
between two segments, the frame turns by the rotation vector psi_k, whose components are the same in
both frames: twist, bending in the leg's plane (about d), bending sideways (about b). Natural legs
are planar: psi0_k = (0, rest angle, 0). With e = psi - psi0,

    E = sum_k EA_k / (2 l0_k) (l_k - l0_k - c_k)^2 + sum_k e_k . B_k e_k / 2,
    c_k = q_k (e_d^2 + e_b^2),      q_k = h_k^3 / (24 w_k^2).

B_k = diag(G J, E I, E I_b) / w_k, with the weights w_k and the correction c_k of `rod.py`.
Kelvin-Voigt damping adds beta times the strain rates to the strains. A material that relaxes has two
Maxwell branches beside the springs, each with the share g of the modulus and the relaxation time T.
With a strain e of a segment (twist, bending in the plane and sideways, extension) and the strain a
of the branch's damper,

    stress / modulus = e + beta de/dt + sum g (e - a),      da/dt = (e - a) / T.

The theta scheme's stage value of a is (a_n + r e) / (1 + r), r = theta h / T, so that in a step

    stress / modulus = (1 + A) e + beta de/dt + lag,
    A = sum g / (1 + r),      lag = -sum a_n g / (1 + r).

For slow loads the modulus is Young's, for fast ones (1 + sum g) times as large.

The derivative of a rotation vector is d(psi) = (1 - [psi]/2 + c [psi]^2) beta with the difference
beta of the segments' spins in the frame before the hinge and c = (1 - x cot x) / psi^2, x = psi / 2
(Simo and Vu-Quoc 1986). A moment mu conjugate to psi is therefore, in that frame,

    m = mu + psi x mu / 2 + c psi x (psi x mu).

Correction of the hinges that restores the chain's order where bending and twist meet.

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
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array, Arrays, Shapes, named, zeros
from slot_core.compiled import helper
from slot_core.dynamics.algebra import (
    add,
    cosine_sine,
    cross,
    dot,
    minus,
    plus,
    put,
    row,
    scaled,
)
from slot_core.dynamics.lanes import all_lanes, like, where
from slot_core.elementary import atan2


def segment_shapes(n: int) -> Shapes:
    """State of the n segments of one rod during a step; written by `orient` and `measure`."""
    return {
        "direction": (n, 3),  # t
        "director": (n, 3),  # d
        "length": (n,),  # m
        "per_length": (n,),  # 1/m
        "extension": (n,),  # m, l - l0 - c
        "extension_rate": (n,),  # m/s
        # rad, the components of psi at nodes 0 .. N-2: about t,
        "twist": (n,),
        "twist_rate": (n,),  # rad/s
        "turn": (n,),  # about d, in the plane,
        "turn_rate": (n,),
        "side": (n,),  # about b, sideways
        "side_rate": (n,),
        "curl": (n,),  # c
        # A, by which a material that relaxes is firmer in a step,
        "firm": (1,),
        # and what its branches add to twist, turn, side and extension
        "lag": (n, 4),
    }


Segments = named("Segments", segment_shapes(1), __name__)


def segments(nodes: int, lanes: tuple[int, ...] = ()) -> Arrays:
    """Scratch arrays for one rod of N nodes, or for four with the axis `lanes` = (4,)."""
    return Segments(**zeros(segment_shapes(nodes - 1), lanes))


@helper
def point_along(s, node):
    """Write directions and lengths of the segments between nodes (N, 3), m."""
    for k in range(s.length.size):
        chord = minus(row(node, k + 1), row(node, k))
        length = math.sqrt(dot(chord, chord))
        per_length = 1.0 / length
        s.length[k] = length
        s.per_length[k] = per_length
        put(s.direction, k, scaled(per_length, chord))


@helper
def orient(s, begin, director, spin, rate, time):
    """Write the directors after `time` (s), from directors (N-1, 3) at directions begin (N-1, 3).

    A director turns as little as its segment's direction allows, then about the segment by the
    segment's own rate `spin` (N-1,) less the axes' `rate` (3 numbers), rad/s.
    """
    for k in range(s.length.size):
        t = row(s.direction, k)
        d = transported(row(director, k), row(begin, k), t)
        angle = time * (spin[k] - dot(rate, t))
        put(s.director, k, turned(d, t, angle))


@helper
def frame(s, k):
    """Frame (t, d, b) of segment k."""
    t, d = row(s.direction, k), row(s.director, k)
    return t, d, cross(t, d)


@helper
def frame_before(s, k, clamp):
    """Frame (t, d, b) before the hinge at node k; clamp (3, 3): rows t, d, b before the first."""
    if k > 0:
        return frame(s, k - 1)
    return row(clamp, 0), row(clamp, 1), row(clamp, 2)


@helper
def growth(velocity, before, k):
    """Change of V - V_n along segment k, m/s; V, V_n: (N, 3) velocities of the nodes."""
    along = minus(row(velocity, k + 1), row(velocity, k))
    return add(minus(along, row(before, k + 1)), row(before, k))


@helper
def transported(d, a, t):
    """Vector d, normal to the unit vector a, turned with a to the unit vector t."""
    share = dot(d, t) / (1.0 + dot(a, t))
    return plus(d, -share, add(a, t))


@helper
def turned(d, t, angle):
    """Unit vector d turned about the unit vector t, normal to it, by an angle (rad)."""
    c, s = cosine_sine(angle)
    v = plus(scaled(c, d), s, cross(t, d))
    # one Newton step to the length 1 removes the rounding errors of many steps
    return scaled(1.5 - 0.5 * dot(v, v), v)


@helper
def measure(s, rod, velocity, spin, clamp, clamp_rate):
    """Write extensions, rotation vectors and their rates, after `point_along` and `orient`.

    velocity (N, 3) m/s; spin (N-1,) rad/s; clamp: frame (t, d, b) of the clamp; clamp_rate (3
    numbers), rad/s. The rate of psi is beta - psi x beta / 2 + c psi x (psi x beta).
    """
    before, rate = clamp, clamp_rate
    for k in range(s.length.size):
        own = frame(s, k)
        t = own[0]
        stretching = minus(row(velocity, k + 1), row(velocity, k))
        w = plus(scaled(s.per_length[k], cross(t, stretching)), spin[k], t)
        psi, curl = rotation_vector(before, own)
        beta = minus(w, rate)
        beta = (
            dot(before[0], beta),
            dot(before[1], beta),
            dot(before[2], beta),
        )
        across = cross(psi, beta)
        psi_rate = plus(plus(beta, -0.5, across), curl, cross(psi, across))
        s.curl[k] = curl
        s.twist[k], s.turn[k], s.side[k] = psi
        s.twist_rate[k], s.turn_rate[k], s.side_rate[k] = psi_rate
        bend, side = psi[1] - rod.rest_angle[k], psi[2]
        q = rod.shortening[k]
        bulge = q * (bend * bend + side * side)
        bulging = 2.0 * q * (bend * psi_rate[1] + side * psi_rate[2])
        s.extension[k] = s.length[k] - rod.rest_length[k] - bulge
        s.extension_rate[k] = dot(t, stretching) - bulging
        before, rate = own, w


@helper
def rotation_vector(a, b):
    """Rotation vector psi from frame a to frame b, components in either, and its factor c.

    With g = tan(psi/2) n (Rodrigues) and y = g.g, psi = 2 atan(|g|)/|g| g; up to |g| = 1/4 by
    Gregory's series, whose first neglected term is below 1e-16 there.
    """
    scale = 1.0 / (1.0 + dot(a[0], b[0]) + dot(a[1], b[1]) + dot(a[2], b[2]))
    g = scaled(
        scale,
        (
            dot(a[2], b[1]) - dot(a[1], b[2]),
            dot(a[0], b[2]) - dot(a[2], b[0]),
            dot(a[1], b[0]) - dot(a[0], b[1]),
        ),
    )
    y = dot(g, g)
    small = y < 0.0625
    tail = like(0.0, y)
    for n in range(12, -1, -1):
        tail = 1.0 / (2 * n + 3) - y * tail
    share = 1.0 - y * tail
    if not all_lanes(small):
        size = math.sqrt(max(y, like(1e-12, y)))
        share = where(small, share, atan2(size, like(1.0, size)) / size)
        tail = where(small, tail, (1.0 - share) / max(y, like(1e-12, y)))
    twice = 2.0 * share
    return scaled(twice, g), tail / (twice * twice)


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
        strains = (s.twist[k], bend, s.side[k], s.extension[k])
        for c in range(4):
            memory[k, c, 0] += first * (strains[c] - memory[k, c, 0])
            memory[k, c, 1] += second * (strains[c] - memory[k, c, 1])


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
