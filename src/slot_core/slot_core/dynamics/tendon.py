"""The tendon of a leg: routed along it, or straight from a pulley; slack or broken.

A routed tendon runs from the spool through the clamp at offset d below the centre line. Its length
is l = sum_i w_i (l_i - c_i) + d sum_i v_i psi_i over the rod's segments, with their correction c_i,
and turning angles in the leg's plane. The weights are 1 up to the node of the anchor; there v is
the share of the node's bending that lies before the anchor. A straight tendon is the line from a
pulley on the torso to the anchor, l = |r_a - p| (the paper's virtual pulley). With l_cmd =
l_natural + slack - r_spool theta, the length left by the spool, the tension and the nodal forces
are

    T = max(0, k (l - l_cmd) + c d(l - l_cmd)/dt),      nodal forces -T grad l.

The guide between spool and leg turns the cable by an angle alpha. While the spool winds, the cable
pulls on it with T exp(mu alpha), while it releases with T exp(-mu alpha) (Euler and Eytelwein's
rope friction); in between the spool stands still (`servo.spool_rate`).

For a routed tendon k is the stiffness of the cable in series with the compliance d^2 v (1 - v) / B
of the anchor's node, because the weight v cannot divide the bending of one node; without it
convergence is of first order. The tangent of a straight tendon neglects the rotation of its
direction with the torso: T/l, some N/mm, is small against the torso's inertia in a step, some
kN/mm.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slot_core.compiled import helper
from slot_core.dynamics.rod import Rod
from slot_core.matrices import norm
from slot_core.robot import Array, Tendon


class TendonModel(NamedTuple):
    """Weights of the length, stiffness, damping and spool of a tendon on a rod."""

    along: Array  # (N-1,) w_i, zero where straight
    around: Array  # (N-1,) m, d v_i, zero where straight
    straight: bool
    anchor: int  # node where it ends
    pulley: Array  # (2,) m from the clamp, x and z in leg axes
    relaxed: float  # m, l_cmd at tendon angle zero less the natural length of the segments
    stiffness: float  # N/m
    damping: float  # N s/m
    spool_radius: float  # m


def route(rod: Rod, settings: Tendon) -> TendonModel:
    """Parameters of the tendon on a rod in its natural shape."""
    straight, end = settings.routing == "straight", rod.anchor
    before: Array = (np.arange(len(rod.rest_length)) < end).astype(float)
    around = settings.offset * before
    compliance = 1.0 / settings.cable_stiffness  # m/N
    if end < len(around):
        around[end] = settings.offset * rod.anchor_share
        share = rod.anchor_share * (1.0 - rod.anchor_share)
        compliance += (not straight) * settings.offset * settings.offset * share / rod.bending[end]
    natural = float((around * rod.rest_angle).sum())
    if straight:
        natural = norm(rod.node[end] - settings.pulley)
    return TendonModel(
        along=before * (not straight),
        around=around * (not straight),
        straight=straight,
        anchor=end,
        pulley=settings.pulley,
        relaxed=natural + settings.slack,
        stiffness=1.0 / compliance,
        damping=settings.cable_damping,
        spool_radius=settings.spool_radius,
    )


@helper
def pull(s, tendon, angle, rate, line, fault):
    """Tension (N, zero when slack) at tendon angle (rad) and rate (rad/s), after `measure`.

    line: (length, m, its rate, m/s) of a straight tendon, else zeros; fault (2,): additional slack
    (m), and 1, or 0 for a broken tendon.
    """
    stretch = tendon.spool_radius * angle - tendon.relaxed + line[0] - fault[0]
    speed = tendon.spool_radius * rate + line[1]
    for i in range(s.length.size):
        stretch += tendon.along[i] * s.extension[i] + tendon.around[i] * s.turn[i]
        speed += tendon.along[i] * s.extension_rate[i] + tendon.around[i] * s.turn_rate[i]
    return fault[1] * max(0.0, tendon.stiffness * stretch + tendon.damping * speed)


@helper
def stretch_line(out, tendon, node, velocity, turn, turning):
    """Length (m) and rate (m/s) of a straight tendon; writes out (3,): direction and 1 / length.

    node (N, 2), velocity (N, 3) in leg axes; turn (rad) and turning (rad/s) of the clamp.
    """
    a, px, pz = tendon.anchor, tendon.pulley[0], tendon.pulley[1]
    x = node[a, 0] - (node[0, 0] + px - turn * pz)
    z = node[a, 1] - (node[0, 1] + pz + turn * px)
    vx = velocity[a, 0] - (velocity[0, 0] - turning * pz)
    vz = velocity[a, 2] - (velocity[0, 2] + turning * px)
    length = math.sqrt(x * x + z * z)
    out[2] = 1.0 / length
    out[0], out[1] = x * out[2], z * out[2]
    return length, out[0] * vx + out[1] * vz


@helper
def straight_length(tendon, node):
    """Length of a straight tendon on a leg at nodes (N, 3) from the clamp, m."""
    x = node[tendon.anchor, 0] - tendon.pulley[0]
    z = node[tendon.anchor, 2] - tendon.pulley[1]
    return math.sqrt(x * x + z * z)


@helper
def cable_energy(s, tendon, angle, line, fault):
    """Elastic energy of the taut cable, J, after `measure`; fault as for `pull`.

    line: length of a straight tendon, m, else zero.
    """
    stretch = tendon.spool_radius * angle - tendon.relaxed + line - fault[0]
    for i in range(s.length.size):
        stretch += tendon.along[i] * s.extension[i] + tendon.around[i] * s.turn[i]
    return fault[1] * 0.5 * tendon.stiffness * max(0.0, stretch) ** 2
