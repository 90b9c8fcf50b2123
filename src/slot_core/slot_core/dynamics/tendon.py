"""The routed tendon: from the spool through the clamp, at offset d below the centre line.

Its length is l = sum_i w_i l_i + d sum_i v_i psi_i over the rod's segments and turning angles, with
weights 1 up to the anchor and the covered fraction of the cell that holds the anchor (one half
where the anchor is a node). The spool leaves l_cmd = l_natural + slack - r_spool theta, hence

    T = max(0, k (l - l_cmd) + c d(l - l_cmd)/dt),      nodal forces -T grad l.

k is the cable in series with d^2 sum v_i (1 - v_i) / B_i, the bending of the anchor's own cell,
which the weights leave out; it makes the convergence second order (with v = 1/2: d^2 / (4 B)).
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slot_core.dynamics.compiled import helper
from slot_core.dynamics.rod import Rod
from slot_core.robot import Array
from slot_core.robot import Tendon as TendonSettings


class Tendon(NamedTuple):
    """Gradient weights, stiffness and spool of a tendon on a rod."""

    along: Array  # (N-1,) w_i
    around: Array  # (N-1,) m, d v_i
    relaxed: float  # m, l_cmd at tendon angle zero
    stiffness: float  # N/m
    damping: float  # N s/m
    spool_radius: float  # m


def route(rod: Rod, settings: TendonSettings) -> Tendon:
    """Lay the tendon along a rod in its natural shape."""
    cells = len(rod.rest_length)
    anchor = settings.end_fraction * cells  # in cells; node i bends over [i - 1/2, i + 1/2]
    along = np.clip(anchor - np.arange(cells), 0.0, 1.0)
    covered = np.clip(anchor - np.arange(cells) + 0.5, 0.0, 1.0)
    covered[0] = 1.0  # the clamp's half cell
    uncovered = np.sum(covered * (1.0 - covered) / rod.bending)
    natural = along @ rod.rest_length + settings.offset * (covered @ rod.rest_angle)
    return Tendon(
        along=along,
        around=settings.offset * covered,
        relaxed=float(natural + settings.slack),
        stiffness=float(1.0 / (1.0 / settings.cable_stiffness + settings.offset**2 * uncovered)),
        damping=settings.cable_damping,
        spool_radius=settings.spool_radius,
    )


@helper
def pull(s, tendon, angle, rate):
    """Tension (N, zero when slack) at tendon angle (rad) and rate (rad/s), after `measure`."""
    stretch = tendon.spool_radius * angle - tendon.relaxed
    speed = tendon.spool_radius * rate
    for i in range(s.length.size):
        stretch += tendon.along[i] * s.length[i] + tendon.around[i] * s.turn[i]
        speed += tendon.along[i] * s.stretch_rate[i] + tendon.around[i] * s.turn_rate[i]
    return max(0.0, tendon.stiffness * stretch + tendon.damping * speed)


@helper
def cable_energy(s, tendon, angle):
    """J, stored in the taut cable, after `measure`."""
    stretch = tendon.spool_radius * angle - tendon.relaxed
    for i in range(s.length.size):
        stretch += tendon.along[i] * s.length[i] + tendon.around[i] * s.turn[i]
    return 0.5 * tendon.stiffness * max(0.0, stretch) ** 2
