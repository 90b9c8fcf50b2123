"""Strains of a spatial rod of stretch, bending in both planes and twist, without shear.

Nodes r_0 (clamp) ... r_{N-1} (tip); segment k runs from node k to k+1 and has a frame of unit
vectors: t along it, the director d across the leg's width, and b = t x d. At node k, the hinge
between two segments, the frame turns by the rotation vector psi_k, whose components are the same in
both frames: twist, bending in the leg's plane (about d), bending sideways (about b). Natural legs
are planar: psi0_k = (0, rest angle, 0). With e = psi - psi0,

    E = sum_k EA_k / (2 l0_k) (l_k - l0_k - c_k)^2 + sum_k e_k . B_k e_k / 2,
    c_k = q_k (e_d^2 + e_b^2),      q_k = h_k^3 / (24 w_k^2).

B_k = diag(G J, E I, E I_b) / w_k, with the weights w_k and the correction c_k of `rod.py`.
Kelvin-Voigt damping adds beta times the strain rates to the strains.

The derivative of a rotation vector is d(psi) = (1 - [psi]/2 + c [psi]^2) beta with the difference
beta of the segments' spins in the frame before the hinge and c = (1 - x cot x) / psi^2, x = psi / 2
(Simo and Vu-Quoc 1986). A moment mu conjugate to psi is therefore, in that frame,

    m = mu + psi x mu / 2 + c psi x (psi x mu).
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array
from slot_core.compiled import helper
from slot_core.dynamics.algebra import cosine_sine, cross, dot, put, row
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
    twist: Array  # (N-1,) rad, the components of psi at nodes 0 .. N-2: about t,
    twist_rate: Array  # rad/s
    turn: Array  # about d, in the plane,
    turn_rate: Array
    side: Array  # about b, sideways
    side_rate: Array
    curl: Array  # (N-1,) c
    firm: Array  # (1,) part of the strains of twist, turn, side and extension that adds to them,
    lag: Array  # (N-1, 4) and what adds besides, in a material that relaxes (`relaxation.py`)


def segments(nodes: int, lanes: tuple[int, ...] = ()) -> Segments:
    """Scratch arrays for one rod of N nodes, or for four with the axis `lanes` = (4,)."""
    n = nodes - 1
    shapes = [(n, 3), (n, 3), *[(n,)] * 11, (1,), (n, 4)]
    return Segments(*(np.zeros(shape + lanes) for shape in shapes))


@helper
def point_along(s, node):
    """Write directions and lengths of the segments between nodes (N, 3), m."""
    for k in range(s.length.size):
        x, y, z = (
            node[k + 1, 0] - node[k, 0],
            node[k + 1, 1] - node[k, 1],
            node[k + 1, 2] - node[k, 2],
        )
        length = math.sqrt(x * x + y * y + z * z)
        per_length = 1.0 / length
        s.length[k], s.per_length[k] = length, per_length
        put(s.direction, k, (x * per_length, y * per_length, z * per_length))


@helper
def orient(s, begin, director, spin, rate, time):
    """Write the directors after `time` (s), from directors (N-1, 3) at directions begin (N-1, 3).

    A director turns as little as its segment's direction allows, then about the segment by the
    segment's own rate `spin` (N-1,) less that of the axes, `rate` (3 numbers), rad/s.
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
def transported(d, a, t):
    """Vector d, normal to the unit vector a, turned with a to the unit vector t."""
    share = dot(d, t) / (1.0 + dot(a, t))
    return (
        d[0] - share * (a[0] + t[0]),
        d[1] - share * (a[1] + t[1]),
        d[2] - share * (a[2] + t[2]),
    )


@helper
def turned(d, t, angle):
    """Unit vector d turned about the unit vector t, normal to it, by an angle (rad)."""
    c, s = cosine_sine(angle)
    b = cross(t, d)
    x, y, z = c * d[0] + s * b[0], c * d[1] + s * b[1], c * d[2] + s * b[2]
    # one Newton step to the length 1 removes the rounding errors of many steps
    scale = 1.5 - 0.5 * (x * x + y * y + z * z)
    return scale * x, scale * y, scale * z


@helper
def measure(s, rod, velocity, spin, clamp, clamp_rate):
    """Write extensions, rotation vectors and their rates, after `point_along` and `orient`.

    velocity (N, 3) m/s; spin (N-1,) rad/s; clamp: frame (t, d, b) of the clamp; clamp_rate (3
    numbers), rad/s.
    """
    before, rate = clamp, clamp_rate
    for k in range(s.length.size):
        own = frame(s, k)
        t = own[0]
        ux, uy, uz = (
            velocity[k + 1, 0] - velocity[k, 0],
            velocity[k + 1, 1] - velocity[k, 1],
            velocity[k + 1, 2] - velocity[k, 2],
        )
        w = cross(t, (ux, uy, uz))
        scale, turning = s.per_length[k], spin[k]
        w = (
            w[0] * scale + turning * t[0],
            w[1] * scale + turning * t[1],
            w[2] * scale + turning * t[2],
        )
        psi, curl = rotation_vector(before, own)
        beta = (w[0] - rate[0], w[1] - rate[1], w[2] - rate[2])
        beta = (dot(before[0], beta), dot(before[1], beta), dot(before[2], beta))
        across = cross(psi, beta)
        again = cross(psi, across)
        psi_rate = (
            beta[0] - 0.5 * across[0] + curl * again[0],
            beta[1] - 0.5 * across[1] + curl * again[1],
            beta[2] - 0.5 * across[2] + curl * again[2],
        )
        s.twist[k], s.turn[k], s.side[k], s.curl[k] = psi[0], psi[1], psi[2], curl
        s.twist_rate[k], s.turn_rate[k], s.side_rate[k] = (
            psi_rate[0],
            psi_rate[1],
            psi_rate[2],
        )
        bend, side, q = psi[1] - rod.rest_angle[k], psi[2], rod.shortening[k]
        s.extension[k] = (
            s.length[k] - rod.rest_length[k] - q * (bend * bend + side * side)
        )
        s.extension_rate[k] = (
            t[0] * ux
            + t[1] * uy
            + t[2] * uz
            - 2.0 * q * (bend * psi_rate[1] + side * psi_rate[2])
        )
        before, rate = own, w


@helper
def rotation_vector(a, b):
    """Rotation vector from frame a to frame b, components in either, and its factor c.

    With g = tan(psi/2) n (Rodrigues) and y = g.g, psi = 2 atan(|g|)/|g| g; up to |g| = 1/4 by
    Gregory's series, whose first neglected term is below 1e-16 there.
    """
    g1 = dot(a[2], b[1]) - dot(a[1], b[2])
    g2 = dot(a[0], b[2]) - dot(a[2], b[0])
    g3 = dot(a[1], b[0]) - dot(a[0], b[1])
    scale = 1.0 / (1.0 + dot(a[0], b[0]) + dot(a[1], b[1]) + dot(a[2], b[2]))
    g1, g2, g3 = g1 * scale, g2 * scale, g3 * scale
    y = g1 * g1 + g2 * g2 + g3 * g3
    small, tail = y < 0.0625, like(0.0, y)
    for n in range(12, -1, -1):
        tail = 1.0 / (2 * n + 3) - y * tail
    share = 1.0 - y * tail
    if not all_lanes(small):
        size = math.sqrt(max(y, like(1e-12, y)))
        share = where(small, share, atan2(size, like(1.0, size)) / size)
        tail = where(small, tail, (1.0 - share) / max(y, like(1e-12, y)))
    twice = 2.0 * share
    return (twice * g1, twice * g2, twice * g3), tail / (twice * twice)


@helper
def elastic_energy(s, rod, node, director):
    """Elastic energy of a rod at nodes (N, 3) from its clamp, m, with directors (N-1, 3), in J.

    Writes s but for its rates.
    """
    energy, before = 0.0, ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    point_along(s, node)
    for k in range(s.length.size):
        t, d = row(s.direction, k), row(director, k)
        own = (t, d, cross(t, d))
        psi, _ = rotation_vector(before, own)
        s.turn[k] = psi[1]
        bend = psi[1] - rod.rest_angle[k]
        bulge = rod.shortening[k] * (bend * bend + psi[2] * psi[2])
        s.extension[k] = s.length[k] - rod.rest_length[k] - bulge
        energy += rod.axial[k] * s.extension[k] ** 2 + rod.torsion[k] * psi[0] * psi[0]
        energy += rod.bending[k] * bend * bend + rod.lateral[k] * psi[2] * psi[2]
        before = own
    return 0.5 * energy
