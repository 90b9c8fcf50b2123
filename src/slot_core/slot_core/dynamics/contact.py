"""Contact of a point with the floor: penalty normal force, and viscous or bristle friction.

The normal force at a gap below zero is N = max(0, -k gap - d v_n). Friction is

    viscous:   f = -mu N v_t / sqrt(v_t^2 + eps^2), Coulomb's law regularised, which creeps;
    bristle:   f = -s (k_t z + d_t v_t),  s = min(1, mu N / |k_t z + d_t v_t|),  dz/dt = v_t.

The bristle z of a point is its elastic deflection in the floor's plane. Return mapping limits it to
|z| <= mu N / k_t (Simo and Hughes, Computational Inelasticity, 1998): the point sticks without
creep, then slips. The Newton tangent does not differentiate the scalar factor of the friction law
(it is lagged), so the matrix of the friction is symmetric and dissipative.

A leg's tip is an edge of stiffness k. Along the leg the floor has the line stiffness k' (N/m^2); a
node takes k' ds of it, so the contact does not depend on the number of nodes. A leg touches with
both edges of its width, each of which has half of the stiffness.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math
from typing import NamedTuple

from slot_core.arrays import Array
from slot_core.compiled import helper
from slot_core.dynamics.algebra import (
    dot,
    plus,
    scaled,
    store,
    times_transposed,
)
from slot_core.dynamics.lanes import like, where
from slot_core.dynamics.terrain import Terrain

UNIFORM, DIRECTION, PHASE = range(3)  # dependence of a leg's friction
RELEASING = -1e-3  # rad/s, a tendon with a lower rate counts as released
TINY = 1e-12  # N or m, prevents a division by zero


class Floor(NamedTuple):
    """Parameters of the contact law.

    The contact points of a leg are the four corners of each segment k, 4 k + 2 end + side, at node
    k + end and half_width along the director or against it (side 1, 0).
    """

    stiffness: Array  # (P,) N/m of the contact points of a leg
    damping: Array  # (P,) N s/m
    first: int  # first node of a leg that can touch the floor
    half_width: float  # m
    corner_stiffness: float  # N/m
    corner_damping: float  # N s/m
    corner_friction: float
    friction_velocity: float  # m/s, eps
    varies: int  # UNIFORM, DIRECTION or PHASE
    bristle: float  # tangential over normal stiffness and damping, 0: viscous
    terrain: Terrain


class Friction(NamedTuple):
    """Friction force -(drag v_t + held): drag in N s/m, held in N."""

    drag: float
    held: tuple[float, float, float]


@helper
def normal_force(stiffness, damping, gap, vn):
    """Normal force, N, at the gap (m) and its rate vn (m/s): max(0, -k gap - d vn), 0 above."""
    normal = max(0.0, -stiffness * gap - damping * vn)
    return where(gap < 0.0, normal, like(0.0, normal))


@helper
def coefficient(floor, own, other, rate, outward, slip):
    """Friction coefficient of a leg: `own`, or `other` for slip outward or a released tendon.

    DIRECTION goes over from `own` to `other` with outward / sqrt(slip + eps^2). rate: of the
    tendon, rad/s; outward: slip along the leg's x axis, m/s; slip: squared slip speed, m^2/s^2.
    """
    if floor.varies == DIRECTION:
        along = outward / math.sqrt(slip + floor.friction_velocity**2)
        return 0.5 * (own + other) - 0.5 * (own - other) * along
    if floor.varies == PHASE:
        return where(rate < RELEASING, other, own)
    return own


@helper
def friction_force(floor, limit, tau, stiffness, damping, bristle, v):
    """Friction of a point under the limit mu N (N), by the floor's friction law.

    v: velocity in the floor's plane, m/s; bristle: deflection in that plane at the step's start, m;
    tau: time for which it has grown with v since, s. Viscous friction does not use the bristle.
    """
    if floor.bristle == 0.0:
        zero = like(0.0, limit)
        drag = limit / math.sqrt(dot(v, v) + floor.friction_velocity**2)
        return Friction(drag, (zero, zero, zero))
    k, d = floor.bristle * stiffness, floor.bristle * damping
    rate = k * tau + d
    force = plus(scaled(k, bristle), rate, v)
    share = min(1.0, limit / math.sqrt(dot(force, force) + TINY**2))
    return Friction(share * rate, scaled(share * k, bristle))


@helper
def tangential(axes, bristle, up):
    """A bristle (3,), odom, in other axes, without its part along the floor's normal `up`.

    axes (3, 3): rows are odom's axes in the other axes; up (3,) is in the other axes too.
    """
    v = times_transposed(axes, bristle)
    return plus(v, -dot(v, up), up)


@helper
def advance_bristle(floor, bristle, limit, stiffness, slope, h, v):
    """Integrate a bristle (3,), m, odom, over h (s) in place, then map it back to mu N / k_t.

    It grows with the part of the velocity v, m/s, in the floor's plane. limit: mu N, N; slope (2,):
    of the floor along odom's x and y.
    """
    a, b = slope[0], slope[1]
    along = (v[2] - a * v[0] - b * v[1]) / (1.0 + a * a + b * b)
    grown = plus(bristle, h, (v[0] + along * a, v[1] + along * b, v[2] - along))
    longest = limit / (floor.bristle * stiffness)
    share = min(1.0, longest / math.sqrt(dot(grown, grown) + TINY**2))
    store(bristle, scaled(share, grown))
