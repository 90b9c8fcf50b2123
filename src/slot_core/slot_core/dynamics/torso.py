"""The torso: a rigid body with six degrees of freedom, its gyroscopic term, corners and payload.

In axes fixed to the body, with the force F and the moment M about the centre:

    m dv/dt = F + m g,      J domega/dt + omega x J omega = M.

The payload is a point mass fixed to the torso; a push is an external force and moment.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import itertools
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array
from slot_core.compiled import helper
from slot_core.dynamics.algebra import (
    cross,
    dot,
    minus,
    plus,
    row,
    scaled,
    times,
    times_transposed,
)
from slot_core.dynamics.contact import (
    clearance,
    friction_force,
    normal_force,
    tangential,
)
from slot_core.dynamics.lanes import all_lanes, any_lane, like, where
from slot_core.robot import Torso


class TorsoBox(NamedTuple):
    """Mass, inertia and contact points of the box."""

    mass: float  # kg
    inertia: Array  # (3, 3) kg m^2
    corners: Array  # (8, 3) m, base_link


def box(settings: Torso) -> TorsoBox:
    """Parameters of the torso: mass, inertia and the eight corners of the box."""
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    return TorsoBox(
        settings.mass, settings.inertia, signs * np.array(settings.size)
    )


@helper
def add_inertia(H, g, torso, inv, gravity, v, v0, w, w0):
    """Add the rigid body to the system H (6, 6) x = -g (6,) of the increments x (shift, turn).

    v, w: velocity and angular velocity at the stage, v0, w0 at the step's start, all in body axes;
    inv = 1 / (theta h); gravity (3,) in body axes.
    """
    J = torso.inertia
    gyroscopic = cross(w, times(J, w))
    for i in range(3):
        g[3 + i] += gyroscopic[i]
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
    mass, p = payload[0], (payload[1], payload[2], payload[3])
    rest = (0.0, 0.0, 0.0)
    change = minus(at(v, w, p), at(v0, w0, p))
    centripetal = at(rest, w, at(rest, w, p))
    free = minus(minus(gravity, scaled(inv, change)), centripetal)
    _add_point(H, g, p, scaled(mass, free), 0.0, mass * inv * inv, rest)


@helper
def add_push(g, push, rotation):
    """Add an external force and moment: push (6,), N and N m about the centre, in odom."""
    for k in range(2):
        odom = (push[3 * k], push[3 * k + 1], push[3 * k + 2])
        f = times_transposed(rotation, odom)
        for i in range(3):
            g[3 * k + i] -= f[i]


@helper
def add_corners(H, g, torso, floor, inv, place, axes, v, w, turn, held):
    """Add the contact of the corners; place (3,): centre in odom, m; axes (3, 3): body to odom.

    turn (3,): small rotation of the body since these axes were fixed, rad; held: bristles (8, 3),
    their limits (8,) and the floor's slopes (8, 2), used by bristle friction only.
    """
    bristle, limit, slope = held
    stiffness, damping = floor.corner_stiffness, floor.corner_damping
    for k in range(torso.corners.shape[0]):
        p = row(torso.corners, k)
        gap, up, below = clearance(floor.terrain, place, axes, at(p, turn, p))
        if floor.bristle > 0.0:
            limit[k] = 0.0
            slope[k, 0] = below.slope_x
            slope[k, 1] = below.slope_y
        if all_lanes(gap >= 0.0):
            continue
        u = at(v, w, p)
        vn = dot(up, u)
        u = plus(u, -vn, up)
        normal = normal_force(stiffness, damping, gap, vn)
        most, stuck = floor.corner_friction * normal, u
        if floor.bristle > 0.0:
            limit[k] = most
            stuck = tangential(axes, bristle[k], up)
        hold = friction_force(
            floor, most, 1.0 / inv, stiffness, damping, stuck, u
        )
        if any_lane(normal > 0.0):
            f = minus(
                minus(scaled(normal, up), scaled(hold.drag, u)), hold.held
            )
            drag = hold.drag * inv
            stiff = stiffness + damping * inv - drag
            stiff = where(normal > 0.0, stiff, like(0.0, normal))
            _add_point(H, g, p, f, stiff, drag, up)


@helper
def at(v, w, p):
    """Velocity of the point p of a rigid body: v + w x p."""
    return (
        v[0] + w[1] * p[2] - w[2] * p[1],
        v[1] + w[2] * p[0] - w[0] * p[2],
        v[2] + w[0] * p[1] - w[1] * p[0],
    )


@helper
def _add_point(H, g, p, f, stiff, drag, up):
    """Add force f and tangent C = stiff up up^T + drag I of a point p of the body."""
    (x, y, z), moment = p, cross(p, f)
    for i in range(3):
        g[i] -= f[i]
        g[3 + i] -= moment[i]
    add_row(H, stiff, (*up, *cross(p, up)))
    add_row(H, drag, (1.0, 0.0, 0.0, 0.0, z, -y))
    add_row(H, drag, (0.0, 1.0, 0.0, -z, 0.0, x))
    add_row(H, drag, (0.0, 0.0, 1.0, y, -x, 0.0))


@helper
def add_row(H, weight, row):
    """H += weight row row^T."""
    for i in range(6):
        for j in range(6):
            H[i, j] += weight * row[i] * row[j]
