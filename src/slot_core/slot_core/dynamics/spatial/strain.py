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
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array
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


class Segments(NamedTuple):
    """State of the segments of one rod during a step; written by `orient` and `measure`."""

    direction: Array  # (N-1, 3) t
    director: Array  # (N-1, 3) d
    length: Array  # (N-1,) m
    per_length: Array  # (N-1,) 1/m
    extension: Array  # (N-1,) m, l - l0 - c
    extension_rate: Array  # (N-1,) m/s
    # (N-1,) rad, the components of psi at nodes 0 .. N-2: about t,
    twist: Array
    twist_rate: Array  # rad/s
    turn: Array  # about d, in the plane,
    turn_rate: Array
    side: Array  # about b, sideways
    side_rate: Array
    curl: Array  # (N-1,) c
    firm: Array  # (1,) A, by which a material that relaxes is firmer in a step,
    lag: Array  # (N-1, 4) and what its branches add to twist, turn, side and extension


def segments(nodes: int, lanes: tuple[int, ...] = ()) -> Segments:
    """Scratch arrays for one rod of N nodes, or for four with the axis `lanes` = (4,)."""
    n = nodes - 1
    shapes = dict.fromkeys(Segments._fields, (n,)) | {
        "direction": (n, 3),
        "director": (n, 3),
        "firm": (1,),
        "lag": (n, 4),
    }
    return Segments(
        **{name: np.zeros(shape + lanes) for name, shape in shapes.items()}
    )


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
    before = (row(clamp, 0), row(clamp, 1), row(clamp, 2))
    if k > 0:
        before = frame(s, k - 1)
    return before


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
        _approach(memory[k, 0], s.twist[k], first, second)
        _approach(memory[k, 1], bend, first, second)
        _approach(memory[k, 2], s.side[k], first, second)
        _approach(memory[k, 3], s.extension[k], first, second)


@helper
def _approach(a, strain, first, second):
    """Move both strains a (2,) towards a strain by a share each."""
    a[0] += first * (strain - a[0])
    a[1] += second * (strain - a[1])
