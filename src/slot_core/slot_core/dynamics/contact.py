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

The floor is a plane, or a height map with bilinear interpolation.

The height map is a CSV of heights in m: rows along +y, columns along +x, equal spacing, its middle
at odom's origin. Beyond its edge the floor continues at the height of the edge.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position
# mypy: disable-error-code="no-untyped-def,misc"

import math
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from slot_core import config
from slot_core.arrays import Array, named
from slot_core.compiled import OPTIONS, helper
from slot_core.config import ConfigError
from slot_core.dynamics.algebra import (
    dot,
    minus,
    plus,
    plus_dot,
    row,
    scaled,
    store,
    times_transposed,
)
from slot_core.dynamics.lanes import LANES, join, lane, like, where
from slot_core.refusal import read_text

SIZE_MAX = 10_000_000  # bytes of a height map


class Terrain(NamedTuple):
    """Heights on a grid."""

    height: Array  # (rows, columns) m; one row: a plane at z = 0
    spacing: float  # m


Ground = named(
    "Ground",
    [
        "height",
        "slope_x",
        "slope_y",
    ],
    __name__,
)
"""The floor below a point: height (m) and slopes along odom's x and y."""


PLANE = Terrain(np.zeros((1, 1)), 1.0)


def read_terrain(name: str, spacing: float) -> Terrain:
    """The height map `config/scene/<name>`, or the plane for an empty name; raises ConfigError."""
    if not name:
        return PLANE
    path = config.config_dir() / "scene" / name
    try:
        lines = read_text(path, SIZE_MAX).splitlines()
        height = np.loadtxt(lines, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise ConfigError(f"scene/{name}: {error}") from None
    if min(height.shape) < 2 or not np.all(np.isfinite(height)):
        raise ConfigError(
            f"scene/{name}: needs 2 x 2 finite heights, has {height.shape}"
        )
    return Terrain(height, spacing)


@helper
def _ground(terrain, x, y):
    """`ground` below one point."""
    rows, columns = terrain.height.shape
    i, u, per_x = _cell(x, terrain.spacing, columns)
    j, v, per_y = _cell(y, terrain.spacing, rows)
    a, b = terrain.height[j, i], terrain.height[j, i + 1]
    c, d = terrain.height[j + 1, i], terrain.height[j + 1, i + 1]
    slope_x = ((1.0 - v) * (b - a) + v * (d - c)) * per_x
    slope_y = ((1.0 - u) * (c - a) + u * (d - b)) * per_y
    height = (1.0 - v) * ((1.0 - u) * a + u * b) + v * ((1.0 - u) * c + u * d)
    return Ground(height, slope_x, slope_y)


@helper
def _cell(x, spacing, count):
    """Cell of a coordinate, fraction within it, and 1 / spacing, which is 0 beyond the edge."""
    place = x / spacing + 0.5 * (count - 1)
    if not place >= 0.0:  # also taken for NaN
        return 0, 0.0, 0.0
    if place > count - 1.0:
        return count - 2, 1.0, 0.0
    cell = min(int(place), count - 2)
    return cell, place - cell, 1.0 / spacing


@helper
def clearance(terrain, centre, axes, r):
    """Gap (m) of a point above the floor, the floor's normal (3 numbers), and the Ground below.

    r (3 numbers): m from `centre` (3, odom), in axes of which `axes` (3, 3) has odom's in its rows;
    the normal is in the same axes. The gap is the distance from the plane tangent to the ground.
    """
    up = row(axes, 2)
    height = plus_dot(centre[2], up, r)
    level = like(0.0, height)
    if terrain.height.shape[0] == 1:  # no height map
        return height, up, Ground(level, level, level)
    east = plus_dot(centre[0], row(axes, 0), r)
    north = plus_dot(centre[1], row(axes, 1), r)
    below = ground(terrain, east, north)
    a, b = below.slope_x, below.slope_y
    tall = 1.0 / math.sqrt(1.0 + a * a + b * b)
    up = minus(minus(up, scaled(a, row(axes, 0))), scaled(b, row(axes, 1)))
    return (height - below.height) * tall, scaled(tall, up), below


def ground(terrain, x, y):
    """The Ground below (x, y) in odom, m, numbers or Lanes; can be called in kernels only."""
    raise NotImplementedError("only in kernels")


@overload(ground, jit_options=OPTIONS)  # type: ignore[arg-type]
def _overload_ground(terrain, x, y):
    if x != LANES:
        return lambda terrain, x, y: _ground(terrain, x, y)  # noqa: PLW0108 - not a dispatcher

    def each(terrain, x, y):
        a = _ground(terrain, lane(x, 0), lane(y, 0))
        b = _ground(terrain, lane(x, 1), lane(y, 1))
        c = _ground(terrain, lane(x, 2), lane(y, 2))
        d = _ground(terrain, lane(x, 3), lane(y, 3))
        return Ground(
            join(a[0], b[0], c[0], d[0]),
            join(a[1], b[1], c[1], d[1]),
            join(a[2], b[2], c[2], d[2]),
        )

    return each


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


Friction = named(
    "Friction",
    [
        "drag",
        "held",
    ],
    __name__,
)
"""Friction force -(drag v_t + held): drag in N s/m, held in N."""


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
