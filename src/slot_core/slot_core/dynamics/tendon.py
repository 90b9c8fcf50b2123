"""The tendon of a leg: routed along it; slack or broken.

It runs from the spool through the clamp at offset d below the centre line. Its length is
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
from slot_core.dynamics.rod import Rod
from slot_core.robot import Tendon


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
        along = tendon.along[i] * s.extension[i]
        stretch += along + tendon.around[i] * s.turn[i]
    force = tendon.stiffness * stretch
    speed = tendon.spool_radius * rate
    for i in range(s.length.size):
        along = tendon.along[i] * s.extension_rate[i]
        speed += along + tendon.around[i] * s.turn_rate[i]
    return fault[1] * max(0.0, force + tendon.damping * speed)
