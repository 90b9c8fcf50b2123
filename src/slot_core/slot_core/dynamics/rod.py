"""The soft leg as a chain of N nodes and N - 1 segments: stiffness, mass and natural shape.

Segment i runs from node i to i + 1; node i is the hinge between the segments i - 1 and i, and node
0 the clamp. The strains and their energy are in `spatial/strain.py`. Four choices make the chain's
error fall with the fourth power of the segments' length for tip loads and natural frequencies in
one plane:

- A hinge has the stiffness E I_i / w_i. The deflection of the chain is then a sum over its hinges
  that approximates the integral over the curvature. The weights w_i are Gregory's, of fourth
  order, applied on both sides of the tendon's anchor, where the curvature jumps.
- The length of a segment is corrected by c_i = h^3/24 (change of curvature)^2, h its arc length:
  h^2/12 of it comes from the hinges' sum, -h^2/24 from the chord being shorter than its arc.
- The mass moves linearly between two nodes. The kinetic energy of a segment is
  (m_a v_a^2 + m_b v_b^2 - mu (v_b - v_a)^2) / 2 with mu = rho A h / 6 at its middle.
- Lengths and angles at rest are those between nodes on the natural curve.

The tendon of a leg is routed along it, and may be slack or broken. It runs from the spool through
the clamp at offset d below the centre line. Its length is
l = sum_i w_i (l_i - c_i) + d sum_i v_i psi_i over the rod's segments, with their correction c_i,
and turning angles in the leg's plane. The weights are 1 up to the node of the anchor; there v is
the share of the node's bending that lies before the anchor. With l_cmd = l_natural + slack -
r_spool theta, the length left by the spool, the tension and the nodal forces are

    T = max(0, k (l - l_cmd) + c d(l - l_cmd)/dt),      nodal forces -T grad l.

The guide between spool and leg turns the cable by an angle alpha. While the spool winds, the cable
pulls on it with T exp(mu alpha), while it releases with T exp(-mu alpha) (Euler and Eytelwein's
rope friction); in between the spool stands still (`servo.spool_rate`).

k is the stiffness of the cable in series with the compliance d^2 v (1 - v) / B of the anchor's
node, because the weight v cannot divide the bending of one node; without it convergence is of first
order.
"""

# mypy: disable-error-code="no-untyped-def"

from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array
from slot_core.compiled import helper
from slot_core.elementary import atan2, hypot
from slot_core.matrices import interpolated
from slot_core.robot import Leg, Tendon
from slot_core.section import second_moment, torsion_constant


class Rod(NamedTuple):
    """A discretised rod: N nodes, N-1 segments. The natural shape lies in the plane of x and z."""

    node: Array  # (N, 2) m, natural shape, clamp at the origin
    arc: Array  # (N,) m, arc length of the natural shape
    mass: Array  # (N,) kg
    coupling: Array  # (N-1,) kg, mu
    spin: Array  # (N-1,) kg m^2, polar moment of inertia about the segment
    rest_length: Array  # (N-1,) m
    # (N-1,) rad, natural turning angles psi0 at nodes 0 .. N-2
    rest_angle: Array
    shortening: Array  # (N-1,) m/rad^2, q = h^3 / (24 w^2)
    axial: Array  # (N-1,) N/m, EA/l0
    bending: Array  # (N-1,) N m/rad, in the plane
    lateral: Array  # (N-1,) N m/rad, out of the plane
    torsion: Array  # (N-1,) N m/rad
    anchor: int  # the node where the tendon ends
    # share of that node's bending that lies before the anchor
    anchor_share: float
    damping_time: float  # s, beta
    relaxation: Array  # (2, 2) shares and times (s) of the Maxwell branches, see spatial/strain


class Sections(NamedTuple):
    """Stiffness and mass of sections at any places."""

    axial: Array  # N, E A
    bending: Array  # N m^2, E I in the plane
    lateral: Array  # N m^2, E I out of the plane
    torsion: Array  # N m^2, G J
    mass: Array  # kg/m
    spin: Array  # kg m, polar moment of inertia per length


def discretise(leg: Leg, nodes: int, anchor: float) -> Rod:
    """Discretise the leg, with equal steps of arc length on each side of its tendon's anchor.

    anchor: arc length of the anchor as a share of the leg's.
    """
    before = round(anchor * (nodes - 1))
    behind = np.linspace(anchor, 1.0, nodes - before)[1:]
    arc = leg.arc_length() * np.append(
        np.linspace(0.0, anchor, before + 1), behind
    )
    node = np.zeros((nodes, 2))
    x, along = leg.arc
    node[:, 0] = interpolated(arc, along, x)
    node[:, 1] = leg.shape(node[:, 0]) - leg.shape(0.0)
    return build(leg, node, arc, before)


def build(leg: Leg, node: Array, arc: Array, anchor: int) -> Rod:
    """A rod with the leg's sections and material: natural nodes (N, 2) at arc lengths (N,), m."""
    step, fraction = np.diff(arc), arc / arc[-1]
    before, behind = weights(step[:anchor]), weights(step[anchor:])
    extent = np.append(before, np.zeros(len(node) - len(before)))
    extent[anchor:] += behind
    middle = sections(leg, (fraction[1:] + fraction[:-1]) / 2)
    chain = links(node, arc, extent, sections(leg, fraction), middle)
    # a leg's tip has no hinge
    hinges = {n: chain[n][:-1] for n in ("bending", "lateral", "torsion")}
    return Rod(
        node=node,
        arc=arc,
        **chain | hinges,
        anchor=anchor,
        anchor_share=float(before[-1] / (before[-1] + behind[0])),
        damping_time=leg.damping_time,
        relaxation=np.array([leg.relaxation_share, leg.relaxation_time]),
    )


def links(
    node: Array, arc: Array, extent: Array, hinge: Sections, middle: Sections
) -> dict[str, Array]:
    """Masses and stiffness of a chain of nodes by their names in `Rod`, with hinges at all nodes.

    node: (N, 2), natural; arc: (N,) arc lengths; extent: (N,) hinges' weights, m. hinge, middle:
    sections at the nodes and at the middles of the segments.
    """
    chord, step = np.diff(node, axis=0), np.diff(arc)
    rest_length = hypot(chord[:, 0], chord[:, 1])
    return dict(
        mass=lumped(hinge.mass, step),
        coupling=middle.mass * step / 6,
        spin=middle.spin * step,
        rest_length=rest_length,
        rest_angle=np.diff(atan2(chord[:, 1], chord[:, 0]), prepend=0.0),
        shortening=step * np.square(step) / (24 * np.square(extent[:-1])),
        axial=middle.axial / rest_length,
        bending=hinge.bending / extent,
        lateral=hinge.lateral / extent,
        torsion=hinge.torsion / extent,
    )


def sections(leg: Leg, fraction: Array) -> Sections:
    """Sections of the leg at shares of its arc length."""
    width, thick = leg.width, leg.thickness(fraction)
    inner, outer = second_moment(width, thick), second_moment(thick, width)
    return Sections(
        axial=leg.young_modulus * width * thick,
        bending=leg.young_modulus * inner,
        lateral=leg.young_modulus * outer,
        torsion=leg.shear_modulus * torsion_constant(width, thick),
        mass=leg.density * width * thick,
        spin=leg.density * (inner + outer),
    )


def lumped(per_length: Array, step: Array) -> Array:
    """(N, ...) kg, the masses of segments of `step` (m) at their ends, for a linear course between.

    Total and centre of mass stay the same.
    """
    mass = np.zeros_like(per_length)
    mass[:-1] += step / 6 * (2 * per_length[:-1] + per_length[1:])
    mass[1:] += step / 6 * (per_length[:-1] + 2 * per_length[1:])
    return mass


def weights(step: Array) -> Array:
    """(n + 1,) weights of a sum over n equal steps: trapezoidal rule with Gregory's corrections.

    Of fourth order in the step where the summand is smooth, from three steps on.
    """
    weight = np.zeros(len(step) + 1)
    weight[:-1] += step / 2
    weight[1:] += step / 2
    h = step[0] if len(step) else 0.0
    if len(step) > 1:  # - h/12 (first differences at the ends)
        weight[[0, -1]] -= h / 12
        weight[1] += h / 12
        weight[-2] += h / 12
    if len(step) > 2:  # - h/24 (second differences)
        weight[[0, -1]] -= h / 24
        weight[1] += h / 12
        weight[-2] += h / 12
        weight[2] -= h / 24
        weight[-3] -= h / 24
    return weight


class TendonModel(NamedTuple):
    """Weights of the length, stiffness, damping and spool of a tendon on a rod."""

    along: Array  # (N-1,) w_i
    around: Array  # (N-1,) m, d v_i
    relaxed: float  # m, l_cmd at tendon angle zero less the natural length of the segments
    stiffness: float  # N/m
    damping: float  # N s/m
    spool_radius: float  # m


def route(rod: Rod, settings: Tendon) -> TendonModel:
    """Parameters of the tendon on a rod in its natural shape."""
    end = rod.anchor
    along: Array = (np.arange(len(rod.rest_length)) < end).astype(float)
    around = settings.offset * along
    compliance = 1.0 / settings.cable_stiffness  # m/N
    if end < len(around):
        around[end] = settings.offset * rod.anchor_share
        share = rod.anchor_share * (1.0 - rod.anchor_share)
        compliance += (
            settings.offset * settings.offset * share / rod.bending[end]
        )
    return TendonModel(
        along=along,
        around=around,
        relaxed=float((around * rod.rest_angle).sum()) + settings.slack,
        stiffness=1.0 / compliance,
        damping=settings.cable_damping,
        spool_radius=settings.spool_radius,
    )


@helper
def pull(s, tendon, angle, rate, fault):
    """Tension (N, zero when slack) at tendon angle (rad) and rate (rad/s), after `measure`.

    fault (2,): additional slack (m), and 1, or 0 for a broken tendon.
    """
    stretch = tendon.spool_radius * angle - tendon.relaxed - fault[0]
    for i in range(s.length.size):
        stretch += (
            tendon.along[i] * s.extension[i] + tendon.around[i] * s.turn[i]
        )
    force = tendon.stiffness * stretch
    speed = tendon.spool_radius * rate
    for i in range(s.length.size):
        speed += (
            tendon.along[i] * s.extension_rate[i]
            + tendon.around[i] * s.turn_rate[i]
        )
    return fault[1] * max(0.0, force + tendon.damping * speed)
