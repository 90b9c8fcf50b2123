"""The torso: a rigid body with six degrees of freedom, its gyroscopic term and its corners.

In axes fixed to the body, with the force F and the moment M about the centre:

    m dv/dt = F + m g,      J domega/dt + omega x J omega = M.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from slot_core.dynamics.compiled import helper
from slot_core.dynamics.contact import touch
from slot_core.robot import Array
from slot_core.robot import Torso as TorsoSettings


class Torso(NamedTuple):
    """Mass, inertia and contact points of the box."""

    mass: float  # kg
    inertia: Array  # (3, 3) kg m^2
    corners: Array  # (8, 3) m, base_link


def box(settings: TorsoSettings) -> Torso:
    """Numbers for the kernel."""
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    return Torso(settings.mass, settings.inertia, signs * np.array(settings.size))


@helper
def add_inertia(H, g, torso, inv, gravity, v, v0, w, w0):
    """Add the rigid body to the system H (6, 6) x = -g (6,), x = increments of (position, angle).

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
def add_corners(H, g, torso, floor, friction, inv, height, up, v, w, turn):
    """Add the corners' contact; height of the centre (m), up (3,) the floor's normal in body axes.

    turn (3,) is the small rotation of the body since these axes were fixed, rad.
    """
    for k in range(torso.corners.shape[0]):
        x, y, z = torso.corners[k, 0], torso.corners[k, 1], torso.corners[k, 2]
        gap = height
        gap += up[0] * (x + turn[1] * z - turn[2] * y)
        gap += up[1] * (y + turn[2] * x - turn[0] * z)
        gap += up[2] * (z + turn[0] * y - turn[1] * x)
        if gap >= 0.0:
            continue
        vx = v[0] + w[1] * z - w[2] * y
        vy = v[1] + w[2] * x - w[0] * z
        vz = v[2] + w[0] * y - w[1] * x
        vn = up[0] * vx + up[1] * vy + up[2] * vz
        normal, c = touch(floor, friction, gap, vn, vx, vy, vz)
        if normal > 0.0:
            stiff = floor.stiffness + floor.damping * inv - c * inv
            fx = up[0] * (normal + c * vn) - c * vx
            fy = up[1] * (normal + c * vn) - c * vy
            fz = up[2] * (normal + c * vn) - c * vz
            _add_point(H, g, x, y, z, fx, fy, fz, stiff, c * inv, up)


@helper
def _add_point(H, g, x, y, z, fx, fy, fz, stiff, drag, up):
    """Add force f and tangent C = stiff up up^T + drag I of a point (x, y, z) of the body."""
    force = (fx, fy, fz, y * fz - z * fy, z * fx - x * fz, x * fy - y * fx)
    for i in range(6):
        g[i] -= force[i]
    lever = (y * up[2] - z * up[1], z * up[0] - x * up[2], x * up[1] - y * up[0])
    _add_row(H, stiff, (up[0], up[1], up[2], lever[0], lever[1], lever[2]))
    _add_row(H, drag, (1.0, 0.0, 0.0, 0.0, z, -y))
    _add_row(H, drag, (0.0, 1.0, 0.0, -z, 0.0, x))
    _add_row(H, drag, (0.0, 0.0, 1.0, y, -x, 0.0))


@helper
def _add_row(H, weight, row):
    """H += weight row row^T."""
    for i in range(6):
        for j in range(6):
            H[i, j] += weight * row[i] * row[j]
