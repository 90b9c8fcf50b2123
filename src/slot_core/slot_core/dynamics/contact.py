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

from __future__ import annotations

import math
from typing import NamedTuple

from slot_core.arrays import Array
from slot_core.compiled import helper
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
    """Friction force -(drag v_t + (x, y, z)): drag in N s/m, x, y, z in N."""

    drag: float
    x: float
    y: float
    z: float


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
    zero = like(0.0, limit)
    if floor.bristle == 0.0:
        slip = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
        return Friction(
            limit / math.sqrt(slip + floor.friction_velocity**2), zero, zero, zero
        )
    k, d = floor.bristle * stiffness, floor.bristle * damping
    rate = k * tau + d
    fx, fy, fz = (
        k * bristle[0] + rate * v[0],
        k * bristle[1] + rate * v[1],
        k * bristle[2] + rate * v[2],
    )
    share = min(1.0, limit / math.sqrt(fx * fx + fy * fy + fz * fz + TINY**2))
    k = share * k
    return Friction(share * rate, k * bristle[0], k * bristle[1], k * bristle[2])


@helper
def tangential(axes, bristle, up):
    """A bristle (3,), odom, in other axes, without its part along the floor's normal `up`.

    axes (3, 3): rows are odom's axes in the other axes; up (3,) is in the other axes too.
    """
    a, b, c = bristle[0], bristle[1], bristle[2]
    x = a * axes[0, 0] + b * axes[1, 0] + c * axes[2, 0]
    y = a * axes[0, 1] + b * axes[1, 1] + c * axes[2, 1]
    z = a * axes[0, 2] + b * axes[1, 2] + c * axes[2, 2]
    along = x * up[0] + y * up[1] + z * up[2]
    return x - along * up[0], y - along * up[1], z - along * up[2]


@helper
def advance_bristle(floor, bristle, limit, stiffness, slope, h, x, y, z):
    """Integrate a bristle (3,), m, odom, over h (s) in place, then map it back to mu N / k_t.

    It grows with the part of the velocity (x, y, z), m/s, in the floor's plane. limit: mu N, N;
    slope (2,): of the floor along odom's x and y.
    """
    a, b = slope[0], slope[1]
    along = (z - a * x - b * y) / (1.0 + a * a + b * b)
    x = bristle[0] + h * (x + along * a)
    y = bristle[1] + h * (y + along * b)
    z = bristle[2] + h * (z - along)
    longest = limit / (floor.bristle * stiffness)
    share = min(1.0, longest / math.sqrt(x * x + y * y + z * z + TINY**2))
    bristle[0], bristle[1], bristle[2] = share * x, share * y, share * z
