"""Time stepping of the paper's model; `paper_robot.py` gives its equations."""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import math

from slot_core.compiled import helper, kernel
from slot_core.dynamics.algebra import orthonormalise, product, rotation, times
from slot_core.dynamics.handle import contents


@kernel
def advance_legs(handle, steps, h):
    """Advance legs by `steps` steps of h (s).

    handle: of (model, state). Returns (steps done, failed node), where -1 means that none failed
    and node i of leg k has the number k N + i.
    """
    model, state = contents(handle)
    for done in range(steps):
        failed = _step_legs(model, state, h)
        if failed >= 0:
            return done + 1, failed
    return steps, -1


@kernel
def advance_robot(handle, steps, substeps, h):
    """Advance four legs and the torso by `steps` times `substeps` steps of h (s).

    handle: of (leg model, leg state, torso, torso state). Returns what `advance_legs` returns.
    """
    model, legs, torso, state = contents(handle)
    for done in range(steps):
        vx, vy, vz = state.velocity[0], state.velocity[1], state.velocity[2]
        for _ in range(substeps):
            failed = _step_legs(model, legs, h)
            if failed >= 0:
                return done + 1, failed
            _step_torso(torso, state, legs, h)
        _set_specific_force(torso, state, vx, vy, vz, substeps * h)
    return steps, -1


@helper
def _step_legs(model, state, h):
    """One step of every leg; returns the first node that is too fast or NaN, or -1."""
    nodes = model.mass.size
    for k in range(state.tension.size):
        failed = _step_leg(model, state, k, h)
        if failed >= 0:
            return k * nodes + failed
    return -1


@helper
def _step_leg(model, state, k, h):
    """One step of leg k in one pass from base to tip; all forces are those of the old state."""
    node, velocity = state.node[k], state.velocity[k]
    last, failed = model.mass.size - 1, -1
    before_x, before_z, before_m = 0.0, 0.0, 0.0
    for i in range(last + 1):
        after_x, after_z, after_m = 0.0, 0.0, 0.0
        if i < last:
            after_x, after_z, after_m = _segment(model, node, state.angle[k], i)
        fx, fz = _loads(model, node, velocity, i, state.tension[k])
        fx += after_x - before_x
        fz += after_z - before_z
        moment = before_m - after_m + model.pull[i, 2] * state.tension[k]
        before_x, before_z, before_m = after_x, after_z, after_m
        if i == 0:
            state.force[k, 0], state.force[k, 1] = fx, fz
            fx = 0.0  # x is held by the guide
        _move(model, node, velocity, i, fx, fz, h)
        _turn(model, state.angle[k], state.rate[k], i, moment, h)
        square = velocity[i, 0] ** 2 + velocity[i, 1] ** 2
        if failed < 0 and not square <= model.speed_limit**2:  # true for NaN
            failed = i
    return failed


@helper
def _segment(model, node, angle, i):
    """Axial force on node i, x and z, and bending moment of the segment from node i to i + 1."""
    dx, dz = node[i + 1, 0] - node[i, 0], node[i + 1, 1] - node[i, 1]
    length = math.sqrt(dx * dx + dz * dz)
    axial = model.axial[i] * (length - model.spacing) / model.spacing
    return (
        axial * dx / length,
        axial * dz / length,
        model.bending[i] * (angle[i + 1] - angle[i]),
    )


@helper
def _loads(model, node, velocity, i, tension):
    """Forces on node i, x and z, except those of its segments."""
    z, vx, vz = node[i, 1], velocity[i, 0], velocity[i, 1]
    fx = model.pull[i, 0] * tension - model.damping * vx
    fz = model.pull[i, 1] * tension - model.damping * vz - model.mass[i] * model.gravity
    fx -= model.restoring * (node[i, 0] - model.initial[i, 0])
    fz -= model.restoring * (z - model.initial[i, 1])
    if i == 0:
        fz -= model.base_load
    if i >= model.touching:
        friction, normal = floor_force(model, z, vx, vz)
        fx += friction
        fz += normal
    return fx, fz


@helper
def floor_force(model, z, vx, vz):
    """Friction and normal force of the floor on a node; the normal force may be tensile."""
    friction, normal = 0.0, 0.0
    if z < 0.0:
        normal = -model.contact_stiffness * z - model.contact_damping * vz
    if z <= 0.0 and vx != 0.0:
        friction = -math.copysign(model.friction, vx)
    return friction, normal


@helper
def _move(model, node, velocity, i, fx, fz, h):
    """Semi-implicit Euler step of the position of node i."""
    velocity[i, 0] += h * fx / model.mass[i]
    velocity[i, 1] += h * fz / model.mass[i]
    node[i, 0] += h * velocity[i, 0]
    node[i, 1] += h * velocity[i, 1]


@helper
def _turn(model, angle, rate, i, moment, h):
    """Semi-implicit Euler step of the angle of node i."""
    rate[i] += h * (moment - model.damping * rate[i]) / model.inertia[i]
    angle[i] += h * rate[i]


@helper
def _step_torso(torso, state, legs, h):
    """One step of the torso under the legs' forces, gravity, drag, spring and damper."""
    fx, fy, fz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(4):
        x = torso.outward[k, 0] * legs.force[k, 0]
        y = torso.outward[k, 1] * legs.force[k, 0]
        z = legs.force[k, 1]
        r = torso.clamps[k]
        fx, fy, fz = fx + x, fy + y, fz + z
        mx, my, mz = (
            mx + r[1] * z - r[2] * y,
            my + r[2] * x - r[0] * z,
            mz + r[0] * y - r[1] * x,
        )
    _shift(torso, state, times(state.rotation, fx, fy, fz), h)
    _rotate(torso, state, times(torso.mobility, mx, my, mz), h)


@helper
def _shift(torso, state, force, h):
    """Semi-implicit Euler step of the torso's position under the legs' force (odom, N)."""
    v, above = state.velocity, state.position[2] - torso.height
    fx = force[0] - torso.drag * v[0]
    fy = force[1] - torso.drag * v[1]
    fz = force[2] - torso.stiffness * above - torso.damping * v[2]
    v[0] += h * (fx / torso.mass + torso.gravity[0])
    v[1] += h * (fy / torso.mass + torso.gravity[1])
    v[2] += h * (fz / torso.mass + torso.gravity[2])
    for j in range(3):
        state.position[j] += h * v[j]


@helper
def _rotate(torso, state, acceleration, h):
    """I domega/dt = M, without the gyroscopic term, and R <- R exp(h omega)."""
    w = state.rate
    for j in range(3):
        w[j] += h * acceleration[j]
    rotation(state.turn, h * w[0], h * w[1], h * w[2])
    product(state.next, state.rotation, state.turn)
    orthonormalise(state.rotation, state.next)


@helper
def _set_specific_force(torso, state, vx, vy, vz, period):
    """Set the mean specific force over a period (s) that began with the velocity (vx, vy, vz)."""
    v, g, r = state.velocity, torso.gravity, state.rotation
    ax = (v[0] - vx) / period - g[0]
    ay = (v[1] - vy) / period - g[1]
    az = (v[2] - vz) / period - g[2]
    for j in range(3):
        state.specific_force[j] = r[0, j] * ax + r[1, j] * ay + r[2, j] * az
