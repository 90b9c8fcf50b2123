"""Strains of a planar rod of stretch and bending, without shear, in a leg's plane.

Nodes r_0 (clamp) ... r_{N-1} (tip); segment i runs from node i to i+1, with length l_i, direction
(cos phi_i, sin phi_i) and rest length l0_i. The turning angle at node i is psi_i = phi_i -
phi_{i-1}, where phi_{-1} is the clamp's tangent. Energy and Kelvin-Voigt forces, with e_i = psi_i -
psi0_i and the correction c_i = q_i e_i^2 of `rod.py`:

    E   = sum EA_i (l_i - l0_i - c_i)^2 / (2 l0_i) + sum B_i e_i^2 / 2
    n_i = EA_i/l0_i (1 + beta d/dt) (l_i - l0_i - c_i),
    m_i = B_i (1 + beta d/dt) e_i - 2 q_i e_i n_i.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slot_core.compiled import helper
from slot_core.dynamics.algebra import cosine_sine
from slot_core.dynamics.lanes import all_lanes, like, where
from slot_core.elementary import atan2
from slot_core.robot import Array


class PlanarSegments(NamedTuple):
    """State of the segments of one rod during a step; written by `measure` and `load`."""

    direction: Array  # (N-1, 2)
    length: Array  # (N-1,) m
    per_length: Array  # (N-1,) 1/m
    extension: Array  # (N-1,) m, l - l0 - c
    extension_rate: Array  # (N-1,) m/s
    turn: Array  # (N-1,) rad, psi at nodes 0 .. N-2
    turn_rate: Array  # (N-1,) rad/s
    force: Array  # (N-1,) N, n_i, tension positive
    moment: Array  # (N,) N m, m_i; the last is the free end's zero


def segments(nodes: int, lanes: tuple[int, ...] = ()) -> PlanarSegments:
    """Scratch arrays for one rod of N nodes, or for four with the axis `lanes` = (4,)."""
    n = nodes - 1
    shapes = [(n, 2), *[(n,)] * 7, (nodes,)]
    return PlanarSegments(*(np.zeros(shape + lanes) for shape in shapes))


@helper
def measure(s, rod, node, velocity, clamp_angle, clamp_rate):
    """Write lengths, directions, extensions, turning angles and their rates into the segments s.

    node (N, 2) m, x and z; velocity (N, 3) m/s, y not used; clamp_angle phi_{-1}, rad, and
    clamp_rate, rad/s.
    """
    (dx, dz), rate = cosine_sine(clamp_angle), clamp_rate
    for i in range(s.length.size):
        ex, ez = node[i + 1, 0] - node[i, 0], node[i + 1, 1] - node[i, 1]
        length = math.sqrt(ex * ex + ez * ez)
        per_length = 1.0 / length
        ex, ez = ex * per_length, ez * per_length
        ux, uz = velocity[i + 1, 0] - velocity[i, 0], velocity[i + 1, 2] - velocity[i, 2]
        turning = (ex * uz - ez * ux) * per_length
        s.direction[i, 0], s.direction[i, 1] = ex, ez
        s.length[i], s.per_length[i] = length, per_length
        s.turn[i] = angle_between(dx, dz, ex, ez)
        s.turn_rate[i] = turning - rate
        bend, q = s.turn[i] - rod.rest_angle[i], rod.shortening[i]
        s.extension[i] = length - rod.rest_length[i] - q * bend * bend
        s.extension_rate[i] = ex * ux + ez * uz - 2.0 * q * bend * s.turn_rate[i]
        dx, dz, rate = ex, ez, turning


@helper
def angle_between(ax, az, bx, bz):
    """Angle from the unit vector a to the unit vector b, rad, in (-pi, pi].

    psi = 2 atan(y) with y = tan(psi/2) = (a x b) / (1 + a.b); up to |y| = 1/4 by Gregory's series,
    whose first neglected term is below 1e-16 there.
    """
    cross, dot = ax * bz - az * bx, ax * bx + az * bz
    y = cross / (1.0 + dot)
    small, total = y * y < 0.0625, like(0.0, y)
    for n in range(12, -1, -1):
        total = 1.0 / (2 * n + 1) - y * y * total
    angle = 2.0 * y * total
    if all_lanes(small):
        return angle
    return where(small, angle, atan2(cross, dot))


@helper
def load(s, rod, tendon, tension):
    """Write axial forces n_i, N, and moments m_i, N m, under the tendon's tension, N, into s."""
    beta = rod.damping_time
    for i in range(s.length.size):
        stretch = s.extension[i] + beta * s.extension_rate[i]
        bend = s.turn[i] - rod.rest_angle[i]
        s.force[i] = rod.axial[i] * stretch + tension * tendon.along[i]
        moment = rod.bending[i] * (bend + beta * s.turn_rate[i]) + tension * tendon.around[i]
        s.moment[i] = moment - 2.0 * rod.shortening[i] * bend * s.force[i]


@helper
def elastic_energy(s, rod, node, director):
    """Elastic energy of a rod at nodes (N, 3) from its clamp, m, in J; writes s but for its rates.

    director: not used, for the likeness with the spatial rod's.
    """
    dx, dz, energy = 1.0, 0.0, 0.0
    for i in range(s.length.size):
        ex, ez = node[i + 1, 0] - node[i, 0], node[i + 1, 2] - node[i, 2]
        length = math.sqrt(ex * ex + ez * ez)
        ex, ez = ex / length, ez / length
        s.turn[i] = angle_between(dx, dz, ex, ez)
        bend = s.turn[i] - rod.rest_angle[i]
        s.extension[i] = length - rod.rest_length[i] - rod.shortening[i] * bend * bend
        energy += rod.axial[i] * s.extension[i] ** 2 + rod.bending[i] * bend * bend
        dx, dz = ex, ez
    return 0.5 * energy
