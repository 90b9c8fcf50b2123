"""One step of the whole robot: four soft legs and the torso, solved together.

Theta scheme with the stage at t + theta h: with inv = 1 / (theta h),

    M (V - V_n) inv = F(x_n + theta h V, V),      V_{n+1} = V_n + (V - V_n) / theta,

solved for the stage velocity V by Newton's method with a fixed number of iterations.

Unknowns are absolute: a node's velocity in its leg's plane, and the torso's. Across the plane a
node goes with the torso, V_y = v_y + (omega x rho)_y, so its lateral inertia and contact belong to
the torso. Internal forces of a segment see only differences of its nodes, hence torso and leg meet
at the clamp alone, and `elimination` solves the legs one by one. Momentum is exchanged only there.

The axes of a step stand still at R_n exp(theta h omega_n). Stage positions are the mean of the
positions at both ends of the step, each seen from its own torso; a steady spin then does not strain
the legs to second order in h.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import math

from slot_core.dynamics.algebra import (
    orthonormalise,
    product,
    rotation,
    solve,
    times,
    times_transposed,
)
from slot_core.dynamics.compiled import helper, kernel
from slot_core.dynamics.elimination import couple, eliminate, substitute
from slot_core.dynamics.rod import load, measure
from slot_core.dynamics.servo import turning_rate
from slot_core.dynamics.tendon import pull
from slot_core.dynamics.torso import add_corners, add_inertia


@kernel
def advance(model, state, work, start, command, steps, scheme):
    """Advance by `steps` steps; returns (steps done, -1), or where it was lost: see `lost`.

    A step that is lost, or whose last Newton correction is above the limit, is taken again from its
    `start` in 2, 4, ... 2^halvings pieces. Running out of halvings is a loss only if it is `lost`.
    """
    for k in range(steps):
        copy(start.buffer, state.buffer)
        for halving in range(scheme.halvings + 1):
            pieces = 2**halving
            where, correction = -1, 0.0
            for _ in range(pieces):
                change = step(model, state, work, command, scheme.step / pieces, scheme)
                correction = max(correction, change)
                where = lost(state, model.speed_limit)
                if where >= 0:
                    break
            if where < 0 and correction <= scheme.correction_limit:
                break
            if halving < scheme.halvings:
                copy(state.buffer, start.buffer)
                work.counter[0] += 1.0
        if where >= 0:
            return k, where
    return steps, -1


@helper
def copy(out, source):
    """Copy an array; a slice assignment would drag its error message into the compilation."""
    for i in range(source.size):
        out[i] = source[i]


@helper
def lost(state, limit):
    """-1 while all speeds are finite and below the limit, else 0 (torso) or 1 + leg N + node."""
    v, w = state.velocity, state.rate
    if not v[0] * v[0] + v[1] * v[1] + v[2] * v[2] < limit * limit:
        return 0
    if not w[0] * w[0] + w[1] * w[1] + w[2] * w[2] < limit * limit:
        return 0
    legs, nodes = state.node_velocity.shape[:2]
    for leg in range(legs):
        u = state.node_velocity[leg]
        for i in range(nodes):
            if not u[i, 0] * u[i, 0] + u[i, 1] * u[i, 1] + u[i, 2] * u[i, 2] < limit * limit:
                return 1 + leg * nodes + i
    return -1


@helper
def step(model, state, work, command, h, scheme):
    """One step of h, in place; returns the largest change of a node in the last iteration, m/s."""
    theta = scheme.theta
    tau = theta * h
    definite, change = True, 0.0
    _predict(model, state, work, command, h, theta)
    for _ in range(scheme.iterations):
        height = _start_torso(model, state, work, tau)
        for leg in range(4):
            _to_leg_axes(model, work, leg)
            _stage(model, work, leg, tau)
            load_leg(model, state, work, leg, tau)
            definite &= eliminate(model, work, leg, 1.0 / tau, height)
            couple(model, work, leg, 1.0 / tau)
        definite &= solve(work.matrix, work.vector)
        change = 0.0
        for leg in range(4):
            change = max(change, substitute(model, work, leg, 1.0 / tau))
        for i in range(3):
            work.motion[0, i] += work.vector[i] / tau
            work.motion[1, i] += work.vector[3 + i] / tau
    _finish(model, state, work, h, theta)
    work.counter[1] += 0.0 if definite else 1.0
    return math.sqrt(change)


@helper
def _predict(model, state, work, command, h, theta):
    """Fix the step axes, the servos' rates and the first iterate V = V_n."""
    w, v, g = state.rate, state.velocity, model.gravity
    tau = theta * h
    rotation(work.spare[0], tau * w[0], tau * w[1], tau * w[2])
    product(work.rotation, state.rotation, work.spare[0])
    motion, field = work.motion, work.field
    motion[0, 0], motion[0, 1], motion[0, 2] = times_transposed(work.rotation, v[0], v[1], v[2])
    field[1, 0], field[1, 1], field[1, 2] = times_transposed(work.rotation, g[0], g[1], g[2])
    for i in range(3):
        field[0, i] = work.rotation[2, i]
        motion[1, i] = motion[4, i] = w[i]
        motion[3, i] = motion[0, i]
    for leg in range(4):
        torque = model.tendon.spool_radius * state.tension[leg]
        state.tendon_rate[leg] = turning_rate(
            model.servo, command[leg], state.tendon_angle[leg], torque
        )
        _predict_leg(model, state, work, leg, h, theta)


@helper
def _predict_leg(model, state, work, leg, h, theta):
    """Velocities of the step's start in step axes, and stage positions without their motion."""
    w, root = state.rate, model.root[leg]
    wx, wy, wz = times(model.axes[leg], w[0], w[1], w[2])
    to_stage, to_end = work.spare[0], work.spare[1]
    rotation(to_stage, -theta * h * wx, -theta * h * wy, -theta * h * wz)
    rotation(to_end, -h * wx, -h * wy, -h * wz)
    rest = (theta - 1.0) * h
    rotation(work.turns[leg], rest * wx, rest * wy, rest * wz)
    for i in range(state.node.shape[1]):
        u = state.node_velocity[leg, i]
        ux, uy, uz = times(to_stage, u[0], u[1], u[2])
        u, before = work.velocity[leg, i], work.before[leg, i]
        u[0] = before[0] = ux
        u[1] = before[1] = uy
        u[2] = before[2] = uz
        x, z = state.node[leg, i, 0], state.node[leg, i, 1]
        ex, _, ez = times(to_end, root[0] + x, root[1], root[2] + z)
        work.base[leg, i, 0] = (1.0 - theta) * x + theta * (ex - root[0])
        work.base[leg, i, 1] = (1.0 - theta) * z + theta * (ez - root[2])


@helper
def _start_torso(model, state, work, tau):
    """Begin the torso's system with its own inertia and corners; returns its height, m."""
    motion, up = work.motion, work.field[0]
    v, w = motion[0], motion[1]
    height = state.position[2] + tau * (up[0] * v[0] + up[1] * v[1] + up[2] * v[2])
    for i in range(3):
        motion[2, i] = tau * (w[i] - motion[4, i])
    work.matrix[:] = 0.0
    work.vector[:] = 0.0
    H, g, inv = work.matrix, work.vector, 1.0 / tau
    add_inertia(H, g, model.torso, inv, work.field[1], v, motion[3], w, motion[4])
    friction = model.friction[4]
    add_corners(H, g, model.torso, model.floor, friction, inv, height, up, v, w, motion[2])
    return height


@helper
def _to_leg_axes(model, work, leg):
    """Torso's motion, floor's normal and gravity in the axes of a leg."""
    for k in range(3):
        x, y, z = work.motion[k, 0], work.motion[k, 1], work.motion[k, 2]
        out = work.leg_motion[k]
        out[0], out[1], out[2] = times(model.axes[leg], x, y, z)
    for k in range(2):
        x, y, z = work.field[k, 0], work.field[k, 1], work.field[k, 2]
        out = work.leg_field[k]
        out[0], out[1], out[2] = times(model.axes[leg], x, y, z)


@helper
def _stage(model, work, leg, tau):
    """Stage positions; lateral velocities from the torso's."""
    root, v, w = model.root[leg], work.leg_motion[0], work.leg_motion[1]
    rx, ry, rz = root[0], root[1], root[2]
    stage, velocity, base = work.stage[leg], work.velocity[leg], work.base[leg]
    turn, q = work.leg_motion[2], work.turns[leg]
    stage[0, 0], stage[0, 1] = turn[1] * rz - turn[2] * ry, turn[0] * ry - turn[1] * rx
    velocity[0, 0] = v[0] + w[1] * rz - w[2] * ry
    velocity[0, 1] = v[1] + w[2] * rx - w[0] * rz
    velocity[0, 2] = v[2] + w[0] * ry - w[1] * rx
    for i in range(1, stage.shape[0]):
        x, z = base[i, 0], base[i, 1]
        sway = w[2] * (rx + x) - w[0] * (rz + z)
        ux, _, uz = times(q, velocity[i, 0] - v[0], sway, velocity[i, 2] - v[2])
        stage[i, 0], stage[i, 1] = x + tau * ux, z + tau * uz
        velocity[i, 1] = v[1] + w[2] * (rx + stage[i, 0]) - w[0] * (rz + stage[i, 1])


@helper
def load_leg(model, state, work, leg, tau):
    """Geometry, tendon's tension and internal forces of a leg at the iterate."""
    s, w, turn = work.segments, work.leg_motion[1], work.leg_motion[2]
    measure(s, work.stage[leg], work.velocity[leg], -turn[1], -w[1])
    rate = state.tendon_rate[leg]
    work.tension[leg] = pull(s, model.tendon, state.tendon_angle[leg] + tau * rate, rate)
    load(s, model.rod, model.tendon, work.tension[leg])


@helper
def _finish(model, state, work, h, theta):
    """From the stage to the end of the step."""
    v, w, v0, w0 = work.motion[0], work.motion[1], work.motion[3], work.motion[4]
    tau = theta * h
    for i in range(3):
        state.specific_force[i] = (v[i] - v0[i]) / tau - work.field[1, i]
        work.motion[2, i] = v0[i] + (v[i] - v0[i]) / theta
    _move(state, work, h)
    for leg in range(4):
        _finish_leg(model, state, work, leg, h, theta)
        state.tension[leg] = work.tension[leg]
        state.tendon_angle[leg] += h * state.tendon_rate[leg]
    for i in range(3):
        state.rate[i] = w0[i] + (w[i] - w0[i]) / theta


@helper
def _move(state, work, h):
    """Torso's position, velocity and rotation at the end of the step."""
    motion, w = work.motion, work.motion[1]
    dx, dy, dz = times(work.rotation, motion[0, 0], motion[0, 1], motion[0, 2])
    state.position[0] += h * dx
    state.position[1] += h * dy
    state.position[2] += h * dz
    vx, vy, vz = times(work.rotation, motion[2, 0], motion[2, 1], motion[2, 2])
    state.velocity[0], state.velocity[1], state.velocity[2] = vx, vy, vz
    rotation(work.spare[0], h * w[0], h * w[1], h * w[2])
    product(work.spare[1], state.rotation, work.spare[0])
    orthonormalise(state.rotation, work.spare[1])


@helper
def _finish_leg(model, state, work, leg, h, theta):
    """Nodes at the end of the step in the axes of then."""
    root, v, w, w0 = model.root[leg], work.motion[0], work.motion[1], state.rate
    wx, wy, wz = times(model.axes[leg], w[0], w[1], w[2])
    ox, oy, oz = times(model.axes[leg], w0[0], w0[1], w0[2])
    vx, vy, vz = times(model.axes[leg], v[0], v[1], v[2])
    whole, back, rest = work.spare[0], work.spare[1], work.spare[2]
    past = 1.0 / theta
    rotation(whole, -h * wx, -h * wy, -h * wz)
    rotation(back, theta * h * ox, theta * h * oy, theta * h * oz)
    product(rest, whole, back)
    for i in range(state.node.shape[1]):
        u, u0, out = work.velocity[leg, i], work.before[leg, i], state.node_velocity[leg, i]
        x, z = state.node[leg, i, 0], state.node[leg, i, 1]
        if i > 0:
            ax, _, az = times(whole, root[0] + x, root[1], root[2] + z)
            dx, _, dz = times(rest, u[0] - vx, u[1] - vy, u[2] - vz)
            state.node[leg, i, 0] = ax + h * dx - root[0]
            state.node[leg, i, 1] = az + h * dz - root[2]
        ex = u0[0] + (u[0] - u0[0]) * past
        ey = u0[1] + (u[1] - u0[1]) * past
        ez = u0[2] + (u[2] - u0[2]) * past
        out[0], out[1], out[2] = times(rest, ex, ey, ez)
