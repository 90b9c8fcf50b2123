"""Shape of the floor: a plane, or a height map with bilinear interpolation.

The height map is a CSV of heights in m: rows along +y, columns along +x, equal spacing, its middle
at odom's origin. Beyond its edge the floor continues at the height of the edge.
"""

# mypy: disable-error-code="no-untyped-def,misc"

import math
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from slot_core import config
from slot_core.arrays import Array
from slot_core.compiled import OPTIONS, helper
from slot_core.config import ConfigError
from slot_core.dynamics.algebra import minus, plus_dot, row, scaled
from slot_core.dynamics.lanes import LANES, join, lane, like
from slot_core.refusal import read_text

SIZE_MAX = 10_000_000  # bytes of a height map


class Terrain(NamedTuple):
    """Heights on a grid."""

    height: Array  # (rows, columns) m; one row: a plane at z = 0
    spacing: float  # m


class Ground(NamedTuple):
    """The floor below a point: height (m) and slopes along odom's x and y."""

    height: float
    slope_x: float
    slope_y: float


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
def is_uneven(terrain):
    """Whether there is a height map."""
    return terrain.height.shape[0] > 1


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
    if not is_uneven(terrain):
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
