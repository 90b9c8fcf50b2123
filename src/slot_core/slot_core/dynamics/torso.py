"""The torso: a rigid body with six degrees of freedom, its gyroscopic term, corners and payload.

In axes fixed to the body, with the force F and the moment M about the centre:

    m dv/dt = F + m g,      J domega/dt + omega x J omega = M.

The payload is a point mass fixed to the torso; a push is an external force and moment.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array
from slot_core.compiled import helper
from slot_core.dynamics.algebra import times_transposed
from slot_core.dynamics.contact import friction_force, normal_force, tangential
from slot_core.dynamics.terrain import Ground, ground, is_uneven, tilted
from slot_core.robot import Torso


class TorsoBox(NamedTuple):
    """Mass, inertia and contact points of the box."""

    mass: float  # kg
    inertia: Array  # (3, 3) kg m^2
    corners: Array  # (8, 3) m, base_link


def box(settings: Torso) -> TorsoBox:
    """Parameters of the torso: mass, inertia and the eight corners of the box."""
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    return TorsoBox(settings.mass, settings.inertia, signs * np.array(settings.size))


@helper
def add_inertia(H, g, torso, inv, gravity, v, v0, w, w0):
    """Add the rigid body to the system H (6, 6) x = -g (6,) of the increments x (shift, turn).

    v, w: velocity and angular velocity at the stage, v0, w0 at the step's start, all in body axes;
    inv = 1 / (theta h); gravity (3,) in body axes.
    """
    J = torso.inertia
    Lx = J[0, 0] * w[0] + J[0, 1] * w[1] + J[0, 2] * w[2]
    Ly = J[1, 0] * w[0] + J[1, 1] * w[1] + J[1, 2] * w[2]
    Lz = J[2, 0] * w[0] + J[2, 1] * w[1] + J[2, 2] * w[2]
    g[3] += w[1] * Lz - w[2] * Ly
    g[4] += w[2] * Lx - w[0] * Lz
    g[5] += w[0] * Ly - w[1] * Lx
    for i in range(3):
        H[i, i] += torso.mass * inv * inv
        g[i] += torso.mass * ((v[i] - v0[i]) * inv - gravity[i])
        for j in range(3):
            H[3 + i, 3 + j] += J[i, j] * inv * inv
            g[3 + i] += J[i, j] * (w[j] - w0[j]) * inv


@helper
def add_payload(H, g, payload, inv, gravity, v, v0, w, w0):
    """Add a point mass: payload (4,) of mass m, kg, and position p, m; else as `add_inertia`.

    Force on the torso: m (g - dv/dt - dw/dt x p - w x (w x p)).
    """
    mass, x, y, z = payload[0], payload[1], payload[2], payload[3]
    rest = (0.0, 0.0, 0.0)
    ux, uy, uz = at(v, w, x, y, z)
    sx, sy, sz = at(v0, w0, x, y, z)
    cx, cy, cz = at(rest, w, x, y, z)
    cx, cy, cz = at(rest, w, cx, cy, cz)
    f = (
        mass * (gravity[0] - (ux - sx) * inv - cx),
        mass * (gravity[1] - (uy - sy) * inv - cy),
        mass * (gravity[2] - (uz - sz) * inv - cz),
    )
    _add_point(H, g, x, y, z, f, 0.0, mass * inv * inv, rest)


@helper
def add_push(g, push, rotation):
    """Add an external force and moment: push (6,), N and N m about the centre, in odom."""
    for k in range(2):
        f = times_transposed(rotation, push[3 * k], push[3 * k + 1], push[3 * k + 2])
        for i in range(3):
            g[3 * k + i] -= f[i]


@helper
def add_corners(H, g, torso, floor, inv, place, axes, v, w, turn, held):
    """Add the contact of the corners; place (3,): centre in odom, m; axes (3, 3): body to odom.

    turn (3,): small rotation of the body since these axes were fixed, rad; held: bristles (8, 3),
    their limits (8,) and the floor's slopes (8, 2), used by bristle friction only.
    """
    bristle, limit, slope = held
    for k in range(torso.corners.shape[0]):
        x, y, z = torso.corners[k, 0], torso.corners[k, 1], torso.corners[k, 2]
        r = (
            x + turn[1] * z - turn[2] * y,
            y + turn[2] * x - turn[0] * z,
            z + turn[0] * y - turn[1] * x,
        )
        gap, up, below = _gap(floor.terrain, place, axes, r)
        if floor.bristle > 0.0:
            limit[k], slope[k, 0], slope[k, 1] = 0.0, below.slope_x, below.slope_y
        if gap >= 0.0:
            continue
        ux, uy, uz = at(v, w, x, y, z)
        vn = up[0] * ux + up[1] * uy + up[2] * uz
        u = (ux - vn * up[0], uy - vn * up[1], uz - vn * up[2])
        normal = normal_force(floor.corner_stiffness, floor.corner_damping, gap, vn)
        most, stuck = floor.corner_friction * normal, u
        if floor.bristle > 0.0:
            limit[k] = most
            stuck = tangential(axes, bristle[k], up)
        hold = friction_force(
            floor,
            most,
            1.0 / inv,
            floor.corner_stiffness,
            floor.corner_damping,
            stuck,
            u,
        )
        if normal > 0.0:
            f = (
                up[0] * normal - hold.drag * u[0] - hold.x,
                up[1] * normal - hold.drag * u[1] - hold.y,
                up[2] * normal - hold.drag * u[2] - hold.z,
            )
            drag = hold.drag * inv
            stiff = floor.corner_stiffness + floor.corner_damping * inv - drag
            _add_point(H, g, x, y, z, f, stiff, drag, up)


@helper
def _gap(terrain, place, axes, r):
    """Gap (m) of a point r (body axes, from the centre at `place`), floor's normal, and Ground."""
    up = (axes[2, 0], axes[2, 1], axes[2, 2])
    height = place[2] + up[0] * r[0] + up[1] * r[1] + up[2] * r[2]
    if not is_uneven(terrain):
        return height, up, Ground(0.0, 0.0, 0.0)
    east = place[0] + axes[0, 0] * r[0] + axes[0, 1] * r[1] + axes[0, 2] * r[2]
    north = place[1] + axes[1, 0] * r[0] + axes[1, 1] * r[1] + axes[1, 2] * r[2]
    below = ground(terrain, east, north)
    gap, up = tilted(axes, below, height - below.height)
    return gap, up, below


@helper
def at(v, w, x, y, z):
    """Velocity of the point (x, y, z) of a rigid body: v + w x (x, y, z)."""
    return (
        v[0] + w[1] * z - w[2] * y,
        v[1] + w[2] * x - w[0] * z,
        v[2] + w[0] * y - w[1] * x,
    )


@helper
def _add_point(H, g, x, y, z, f, stiff, drag, up):
    """Add force f and tangent C = stiff up up^T + drag I of a point (x, y, z) of the body."""
    _subtract(g, x, y, z, f)
    lever = (y * up[2] - z * up[1], z * up[0] - x * up[2], x * up[1] - y * up[0])
    add_row(H, stiff, (up[0], up[1], up[2], lever[0], lever[1], lever[2]))
    add_row(H, drag, (1.0, 0.0, 0.0, 0.0, z, -y))
    add_row(H, drag, (0.0, 1.0, 0.0, -z, 0.0, x))
    add_row(H, drag, (0.0, 0.0, 1.0, y, -x, 0.0))


@helper
def _subtract(g, x, y, z, f):
    """g -= (f, moment of f about the centre) for the force f at (x, y, z)."""
    force = (
        f[0],
        f[1],
        f[2],
        y * f[2] - z * f[1],
        z * f[0] - x * f[2],
        x * f[1] - y * f[0],
    )
    for i in range(6):
        g[i] -= force[i]


@helper
def add_row(H, weight, row):
    """H += weight row row^T."""
    for i in range(6):
        for j in range(6):
            H[i, j] += weight * row[i] * row[j]
