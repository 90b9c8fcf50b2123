"""The soft leg: a planar geometrically exact rod of stretch and bending, without shear.

Nodes r_0 (clamp) ... r_{N-1} (tip) in the leg's plane; segment i runs from node i to i+1, with
length l_i, direction (cos phi_i, sin phi_i) and rest length l0_i. The turning angle at node i is
psi_i = phi_i - phi_{i-1}, where phi_{-1} is the clamp's tangent. Energy and Kelvin-Voigt forces:

    E   = sum EA_i (l_i - l0_i)^2 / (2 l0_i) + sum B_i (psi_i - psi0_i)^2 / 2
    n_i = EA_i/l0_i (l_i - l0_i + beta dl_i/dt),     m_i = B_i (psi_i - psi0_i + beta dpsi_i/dt)

Bending stiffness B_i = E I_i / ds, and at the clamp E I(ds/4) / (ds/2): the first half cell bends
between the clamp and the first segment. With a full cell there, convergence drops to first order.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_simpson

from slot_core.dynamics.algebra import cosine_sine
from slot_core.dynamics.compiled import helper
from slot_core.dynamics.lanes import every, like, where
from slot_core.robot import Array, Leg


class Rod(NamedTuple):
    """A discretised rod: N nodes, N-1 segments."""

    node: Array  # (N, 2) m, natural shape, clamp at the origin
    mass: Array  # (N,) kg
    rest_length: Array  # (N-1,) m
    rest_angle: Array  # (N-1,) rad, natural turning angles psi0 at nodes 0 .. N-2
    axial: Array  # (N-1,) N/m, EA/l0
    bending: Array  # (N-1,) N m/rad
    damping_time: float  # s, beta


class Segments(NamedTuple):
    """State of the segments of one rod during a step; written by `measure` and `load`."""

    direction: Array  # (N-1, 2)
    length: Array  # (N-1,) m
    per_length: Array  # (N-1,) 1/m
    stretch_rate: Array  # (N-1,) m/s
    turn: Array  # (N-1,) rad, psi at nodes 0 .. N-2
    turn_rate: Array  # (N-1,) rad/s
    force: Array  # (N-1,) N, n_i, tension positive
    moment: Array  # (N,) N m, m_i; the last is the free end's zero


def discretise(leg: Leg, nodes: int) -> Rod:
    """Cut the leg into nodes at equal arc length of its natural shape."""
    x = _equal_arcs(leg, nodes)
    return build(leg, np.column_stack([x, leg.shape(x) - leg.shape(0.0)]), leg.arc_length())


def build(leg: Leg, node: Array, arc_length: float) -> Rod:
    """A rod with the leg's sections and material along natural nodes (N, 2) at equal arc length."""
    chord = np.diff(node, axis=0)
    rest_length = np.hypot(chord[:, 0], chord[:, 1])
    fraction = np.linspace(0.0, 1.0, len(node))
    ds, cell = arc_length * fraction[1], fraction[1]
    middle = (fraction[1:] + fraction[:-1]) / 2
    bent = np.concatenate([[cell / 4], fraction[1:-1]])  # where the turning angles sit
    extent = np.concatenate([[ds / 2], np.full(len(node) - 2, ds)])
    half = leg.density * leg.width * ds / 2
    return Rod(
        node=node,
        mass=half * np.append(_thickness(leg, middle - cell / 4), 0.0)
        + half * np.append(0.0, _thickness(leg, middle + cell / 4)),
        rest_length=rest_length,
        rest_angle=np.diff(np.arctan2(chord[:, 1], chord[:, 0]), prepend=0.0),
        axial=leg.young_modulus * leg.width * _thickness(leg, middle) / rest_length,
        bending=leg.young_modulus * leg.width * _thickness(leg, bent) ** 3 / 12 / extent,
        damping_time=leg.damping_time,
    )


def segments(nodes: int, lanes: tuple[int, ...] = ()) -> Segments:
    """Scratch space for one rod, or with the axis `lanes` = (4,) for four."""
    n = nodes - 1
    shapes = [(n, 2), *[(n,)] * 6, (nodes,)]
    return Segments(*(np.zeros(shape + lanes) for shape in shapes))


def _equal_arcs(leg: Leg, nodes: int) -> Array:
    """Abscissae of the natural shape at equal arc length."""
    x = np.linspace(0.0, leg.reach, 4001)
    arc = cumulative_simpson(np.hypot(1.0, leg.shape.deriv()(x)), x=x, initial=0.0)
    return np.interp(np.linspace(0.0, arc[-1], nodes), arc, x)


def _thickness(leg: Leg, fraction: Array) -> Array:
    return leg.thickness_clamp + (leg.thickness_tip - leg.thickness_clamp) * fraction


@helper
def measure(s, node, velocity, clamp_angle, clamp_rate):
    """Lengths, directions, turning angles and their rates.

    node (N, 2) m, x and z; velocity (N, 3) m/s, y not used; clamp_angle phi_{-1}, rad.
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
        s.stretch_rate[i] = ex * ux + ez * uz
        s.turn[i] = angle_between(dx, dz, ex, ez)
        s.turn_rate[i] = turning - rate
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
    if every(small):
        return angle
    return where(small, angle, math.atan2(cross, dot))


@helper
def load(s, rod, tendon, tension):
    """Axial forces n_i and moments m_i of the rod under the tension of its tendon."""
    beta = rod.damping_time
    for i in range(s.length.size):
        stretch = s.length[i] - rod.rest_length[i] + beta * s.stretch_rate[i]
        bend = s.turn[i] - rod.rest_angle[i] + beta * s.turn_rate[i]
        s.force[i] = rod.axial[i] * stretch + tension * tendon.along[i]
        s.moment[i] = rod.bending[i] * bend + tension * tendon.around[i]


@helper
def elastic_energy(s, rod):
    """J, stretch plus bending, after `measure`."""
    energy = 0.0
    for i in range(s.length.size):
        stretch = s.length[i] - rod.rest_length[i]
        bend = s.turn[i] - rod.rest_angle[i]
        energy += 0.5 * (rod.axial[i] * stretch * stretch + rod.bending[i] * bend * bend)
    return energy
