"""The soft leg: a planar geometrically exact rod of stretch and bending, without shear.

Nodes r_0 (clamp) ... r_{N-1} (tip) in the leg's plane; segment i runs from node i to i+1, with
length l_i, direction (cos phi_i, sin phi_i) and rest length l0_i. The turning angle at node i is
psi_i = phi_i - phi_{i-1}, where phi_{-1} is the clamp's tangent. Energy and Kelvin-Voigt forces:

    E   = sum EA_i (l_i - l0_i)^2 / (2 l0_i) + sum B_i (psi_i - psi0_i)^2 / 2
    n_i = EA_i/l0_i (l_i - l0_i + beta dl_i/dt),     m_i = B_i (psi_i - psi0_i + beta dpsi_i/dt)

Bending stiffness is B_i = E I_i / w_i. The deflection of the chain is then a sum over its hinges
that approximates the integral over the curvature. Its weights w_i are those of the trapezoidal
rule, corrected at the clamp and on both sides of the tendon's anchor, where the curvature jumps.
Without the corrections the error at 22 nodes is four times as large; with a full cell at the clamp
it is of first order.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_simpson

from slot_core.compiled import helper
from slot_core.dynamics.algebra import cosine_sine
from slot_core.dynamics.lanes import all_lanes, like, where
from slot_core.robot import Array, Leg


class Rod(NamedTuple):
    """A discretised rod: N nodes, N-1 segments."""

    node: Array  # (N, 2) m, natural shape, clamp at the origin
    arc: Array  # (N,) m, arc length of the natural shape
    mass: Array  # (N,) kg
    rest_length: Array  # (N-1,) m
    rest_angle: Array  # (N-1,) rad, natural turning angles psi0 at nodes 0 .. N-2
    axial: Array  # (N-1,) N/m, EA/l0
    bending: Array  # (N-1,) N m/rad
    anchor: int  # the node where the tendon ends
    anchor_share: float  # share of that node's bending that lies before the anchor
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


def discretise(leg: Leg, nodes: int, anchor: float) -> Rod:
    """Discretise the leg, with equal steps of arc length on each side of its tendon's anchor.

    anchor: arc length of the anchor over that of the leg.
    """
    arc, node = stations(nodes, anchor) * leg.arc_length(), np.zeros((nodes, 2))
    x = np.linspace(0.0, leg.reach, 4001)
    along = cumulative_simpson(np.hypot(1.0, leg.shape.deriv()(x)), x=x, initial=0.0)
    node[:, 0] = np.interp(arc, along * (arc[-1] / along[-1]), x)
    node[:, 1] = leg.shape(node[:, 0]) - leg.shape(0.0)
    return build(leg, node, arc, round(anchor * (nodes - 1)))


def stations(nodes: int, anchor: float) -> Array:
    """(N,) arc lengths of the nodes over the total, one at the anchor, equal steps on each side."""
    before = round(anchor * (nodes - 1))
    behind = np.linspace(anchor, 1.0, nodes - before)
    return np.append(np.linspace(0.0, anchor, before + 1), behind[1:])


def build(leg: Leg, node: Array, arc: Array, anchor: int) -> Rod:
    """A rod with the leg's sections and material: natural nodes (N, 2) at arc lengths (N,), m."""
    chord = np.diff(node, axis=0)
    rest_length = np.hypot(chord[:, 0], chord[:, 1])
    step, fraction = np.diff(arc), arc / arc[-1]
    before, behind = _weights(step[:anchor]), _weights(step[anchor:])
    extent = np.append(before, np.zeros(len(node) - len(before)))
    extent[anchor:] += behind
    per_angle = leg.young_modulus * leg.width * _thickness(leg, fraction) ** 3 / 12
    quarter = np.diff(fraction) / 4
    half = leg.density * leg.width * step / 2
    mass = np.append(half * _thickness(leg, fraction[:-1] + quarter), 0.0)
    mass[1:] += half * _thickness(leg, fraction[1:] - quarter)
    return Rod(
        node=node,
        arc=arc,
        mass=mass,
        rest_length=rest_length,
        rest_angle=np.diff(np.arctan2(chord[:, 1], chord[:, 0]), prepend=0.0),
        axial=leg.young_modulus
        * leg.width
        * _thickness(leg, (fraction[1:] + fraction[:-1]) / 2)
        / rest_length,
        bending=(per_angle / extent)[:-1],
        anchor=anchor,
        anchor_share=float(before[-1] / extent[anchor]),
        damping_time=leg.damping_time,
    )


def _weights(step: Array) -> Array:
    """(n + 1,) weights of a sum over n equal steps: trapezoidal rule with Gregory's correction.

    Of third order in the step where the summand is smooth. The curvature is smooth on each side of
    the anchor; at the anchor it jumps, because the tendon's moment ends there.
    """
    weight = np.zeros(len(step) + 1)
    weight[:-1] += step / 2
    weight[1:] += step / 2
    if len(step):
        weight[[0, -1]] -= step[0] / 12
        weight[1] += step[0] / 12
        weight[-2] += step[0] / 12
    return weight


def segments(nodes: int, lanes: tuple[int, ...] = ()) -> Segments:
    """Scratch arrays for one rod of N nodes, or for four with the axis `lanes` = (4,)."""
    n = nodes - 1
    shapes = [(n, 2), *[(n,)] * 6, (nodes,)]
    return Segments(*(np.zeros(shape + lanes) for shape in shapes))


def _thickness(leg: Leg, fraction: Array) -> Array:
    return leg.thickness_clamp + (leg.thickness_tip - leg.thickness_clamp) * fraction


@helper
def measure(s, node, velocity, clamp_angle, clamp_rate):
    """Write lengths, directions, turning angles and their rates into the segments s.

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
    if all_lanes(small):
        return angle
    return where(small, angle, math.atan2(cross, dot))


@helper
def load(s, rod, tendon, tension):
    """Write axial forces n_i, N, and moments m_i, N m, under the tendon's tension, N, into s."""
    beta = rod.damping_time
    for i in range(s.length.size):
        stretch = s.length[i] - rod.rest_length[i] + beta * s.stretch_rate[i]
        bend = s.turn[i] - rod.rest_angle[i] + beta * s.turn_rate[i]
        s.force[i] = rod.axial[i] * stretch + tension * tendon.along[i]
        s.moment[i] = rod.bending[i] * bend + tension * tendon.around[i]


@helper
def elastic_energy(s, rod):
    """Elastic energy of stretch and bending, J; call `measure` first."""
    energy = 0.0
    for i in range(s.length.size):
        stretch = s.length[i] - rod.rest_length[i]
        bend = s.turn[i] - rod.rest_angle[i]
        energy += 0.5 * (rod.axial[i] * stretch * stretch + rod.bending[i] * bend * bend)
    return energy
