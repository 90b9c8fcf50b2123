"""One step of the whole robot: four soft legs and the torso, solved together.

Theta scheme with the stage at t + theta h: with inv = 1 / (theta h),

    M (V - V_n) inv = F(x_n + theta h V, V),      V_{n+1} = V_n + (V - V_n) / theta,

solved for the stage velocity V by Newton's method with a fixed number of iterations.

Unknowns are absolute: a node's velocity in its leg's plane, and the torso's. Across the plane a node
goes with the torso: V_y = v_y + (omega x rho)_y, so its lateral inertia and contact belong to the
torso (the `q` columns below). Internal forces of a segment see only differences of its nodes, hence
torso and leg meet at the clamp alone. Momentum is exchanged there and nowhere else.

The axes of a step stand still at R_n exp(theta h omega_n). Stage positions are the mean of the
positions at both ends of the step, each seen from its own torso; a steady spin then does not strain
the legs to second order in h.

Elimination runs from the tip to the clamp. The part of a leg beyond node i acts on the rest through
the node's displacement X and the angle phi of the segment before it: a quadratic form

    F (7 x 8) over (X_x, X_z, phi, q_1, q_2, q_3, lambda | 1)

with q the torso's increments (y, turn about x, turn about z) in leg axes, lambda the change of the
tendon's tension, and the last column the gradient. One segment is one 2 x 2 pivot. At the clamp the
form's six displacements are those of the torso: its 6 x 6 Schur complement falls out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slot_core.dynamics.compiled import helper, kernel
from slot_core.dynamics.contact import Floor, touch
from slot_core.dynamics.rod import Rod, Segments, load, measure, segments
from slot_core.dynamics.servo import Servo, turning_rate
from slot_core.dynamics.tendon import Tendon, pull
from slot_core.dynamics.torso import Torso, add_corners, add_inertia, rotation, solve
from slot_core.robot import Array


class Scheme(NamedTuple):
    """Numbers of the time stepping."""

    step: float  # s, h
    theta: float
    iterations: int
    halvings: int
    correction_limit: float  # m/s


class Model(NamedTuple):
    """The robot and its scene as numbers; legs are equal and in the order FL FR RL RR."""

    rod: Rod
    tendon: Tendon
    torso: Torso
    floor: Floor
    servo: Servo
    friction: Array  # (5,) of the legs and of the torso
    gravity: Array  # (3,) m/s^2, odom
    axes: Array  # (4, 3, 3) base_link to leg axes
    root: Array  # (4, 3) m, clamp from the torso's centre, leg axes
    clamp: Array  # (4, 6, 6) torso increments to the displacements (X, phi, q) of a clamp
    speed_limit: float  # m/s


class State(NamedTuple):
    """The robot's state, views of one buffer; the kernels write it in place."""

    buffer: Array  # all of it
    position: Array  # (3,) m, odom
    rotation: Array  # (3, 3) base_link to odom
    velocity: Array  # (3,) m/s, odom
    rate: Array  # (3,) rad/s, base_link
    node: Array  # (4, N, 2) m from the clamp, leg axes (x, z)
    node_velocity: Array  # (4, N, 3) m/s, absolute, leg axes
    tendon_angle: Array  # (4,) rad
    tendon_rate: Array  # (4,) rad/s, over the last step
    tension: Array  # (4,) N, at the stage of the last step
    specific_force: Array  # (3,) m/s^2, base_link, mean over the last step


class Work(NamedTuple):
    """Scratch space of a step: no step allocates memory. "Step axes" are those of the header."""

    stage: Array  # (4, N, 2) m, node at the stage
    velocity: Array  # (4, N, 3) m/s, V
    before: Array  # (4, N, 3) m/s, V_n in step axes
    base: Array  # (4, N, 2) m, stage position without the part due to V
    segments: Segments
    form: Array  # (7, 8) F
    rest: Array  # (4, 5) form over (q, lambda | 1), upper half
    moved: Array  # (8,) unknowns of the substitution
    back: Array  # (4, N-1, 2, 8) rows for the substitution
    lever: Array  # (4, N-1, 2) 1/m, phi_i = lever . (X_{i+1} - X_i)
    tension: Array  # (4,) N, at the iterate
    release: Array  # (4, 7) lambda = row . (displacements of the clamp, 1)
    reduced: Array  # (6, 7) form of a leg over the displacements of its clamp
    product: Array  # (6, 7)
    matrix: Array  # (6, 6) of the torso
    vector: Array  # (6,)
    turns: Array  # (4, 3, 3) in leg axes: rotation by -(1 - theta) h omega_n
    spare: Array  # (3, 3, 3)
    rotation: Array  # (3, 3) step axes to odom
    motion: Array  # (5, 3) torso in step axes: v, omega, theta h (omega - omega_n), v_n, omega_n
    field: Array  # (2, 3) floor's normal and gravity in step axes
    leg_motion: Array  # (3, 3) v, omega, turn in leg axes
    leg_field: Array  # (2, 3)
    counter: Array  # (2,) halvings, steps with a pivot that was not positive


def state_space(nodes: int) -> State:
    """A state of legs of N nodes, all zero."""
    shapes = [(3,), (3, 3), (3,), (3,), (4, nodes, 2), (4, nodes, 3), (4,), (4,), (4,), (3,)]
    ends = np.cumsum([np.prod(shape) for shape in shapes])
    buffer = np.zeros(ends[-1])
    parts = np.split(buffer, ends[:-1])
    return State(buffer, *(part.reshape(shape) for part, shape in zip(parts, shapes)))


def work_space(nodes: int) -> Work:
    """Scratch space for legs of N nodes."""
    n = nodes - 1
    shapes = [(4, nodes, 2), (4, nodes, 3), (4, nodes, 3), (4, nodes, 2), (), (7, 8), (4, 5), (8,)]
    shapes += [(4, n, 2, 8), (4, n, 2), (4,), (4, 7), (6, 7), (6, 7), (6, 6), (6,), (4, 3, 3)]
    shapes += [(3, 3, 3), (3, 3), (5, 3), (2, 3), (3, 3), (2, 3), (2,)]
    space = [np.zeros(shape) if shape else segments(nodes) for shape in shapes]
    return Work(*space)  # type: ignore[arg-type]


def clamp_maps(axes: Array, root: Array) -> Array:
    """(4, 6, 6) from the torso's increments (position, turn; base_link) to (X, phi, q) of a clamp."""
    maps = np.zeros((4, 6, 6))
    for out, a, (rx, ry, rz) in zip(maps, axes, root):
        shift, turn = np.hstack([a, np.zeros((3, 3))]), np.hstack([np.zeros((3, 3)), a])
        out[0] = shift[0] + turn[1] * rz - turn[2] * ry
        out[1] = shift[2] + turn[0] * ry - turn[1] * rx
        out[2] = -turn[1]
        out[3], out[4], out[5] = shift[1], turn[0], turn[2]
    return maps


@kernel
def advance(model, state, work, start, command, steps, scheme):  # type: ignore[no-untyped-def]
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
def copy(out, source):  # type: ignore[no-untyped-def]
    """Copy an array; a slice assignment would drag its error message into the compilation."""
    for i in range(source.size):
        out[i] = source[i]


@helper
def lost(state, limit):  # type: ignore[no-untyped-def]
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
def step(model, state, work, command, h, scheme):  # type: ignore[no-untyped-def]
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
def times(m, x, y, z):  # type: ignore[no-untyped-def]
    """m (3, 3) times the vector (x, y, z)."""
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z,
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z,
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z,
    )


@helper
def times_transposed(m, x, y, z):  # type: ignore[no-untyped-def]
    """The transpose of m (3, 3) times the vector (x, y, z)."""
    return (
        m[0, 0] * x + m[1, 0] * y + m[2, 0] * z,
        m[0, 1] * x + m[1, 1] * y + m[2, 1] * z,
        m[0, 2] * x + m[1, 2] * y + m[2, 2] * z,
    )


@helper
def product(out, a, b):  # type: ignore[no-untyped-def]
    """out = a b, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@helper
def _predict(model, state, work, command, h, theta):  # type: ignore[no-untyped-def]
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
def _predict_leg(model, state, work, leg, h, theta):  # type: ignore[no-untyped-def]
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
def _start_torso(model, state, work, tau):  # type: ignore[no-untyped-def]
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
def _to_leg_axes(model, work, leg):  # type: ignore[no-untyped-def]
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
def _stage(model, work, leg, tau):  # type: ignore[no-untyped-def]
    """Stage positions; lateral velocities from the torso's."""
    (rx, ry, rz), v, w = _triple(model.root[leg]), work.leg_motion[0], work.leg_motion[1]
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
def _triple(a):  # type: ignore[no-untyped-def]
    return a[0], a[1], a[2]


@helper
def load_leg(model, state, work, leg, tau):  # type: ignore[no-untyped-def]
    """Geometry, tendon's tension and internal forces of a leg at the iterate."""
    s, w, turn = work.segments, work.leg_motion[1], work.leg_motion[2]
    measure(s, work.stage[leg], work.velocity[leg], -turn[1], -w[1])
    rate = state.tendon_rate[leg]
    work.tension[leg] = pull(s, model.tendon, state.tendon_angle[leg] + tau * rate, rate)
    load(s, model.rod, model.tendon, work.tension[leg])


class Column(NamedTuple):
    """How the displacements (X_x, X_z, phi) are coupled to one other unknown."""

    x: float
    z: float
    phi: float


class Pivot(NamedTuple):
    """Inverse of a symmetric 2 x 2 matrix."""

    xx: float
    xz: float
    zz: float
    positive: bool


class Node(NamedTuple):
    """Tangent C and gradient g of a node (in leg axes), and y's share in q: (1, jx, jz)."""

    cxx: float
    cxy: float
    cxz: float
    cyy: float
    cyz: float
    czz: float
    gx: float
    gy: float
    gz: float
    jx: float
    jz: float


@helper
def eliminate(model, work, leg, inv, height):  # type: ignore[no-untyped-def]
    """Eliminate the segments of a leg from tip to clamp; False where a pivot is not positive.

    The form over (X, phi) stands in local variables, its rest over (q, lambda | 1) in `rest`.
    """
    s, rest = work.segments, work.rest
    viscous = 1.0 + model.rod.damping_time * inv
    q1 = q2 = q3 = cable = one = Column(0.0, 0.0, 0.0)
    xx = xz = zz = xf = zf = ff = 0.0
    definite = True
    rest[:] = 0.0
    for i in range(s.length.size, 0, -1):
        node = _node(model, work, leg, i, inv, height)
        xx, xz, zz = xx + node.cxx, xz + node.cxz, zz + node.czz
        q1, q2, q3 = _add(q1, node, 1.0), _add(q2, node, node.jx), _add(q3, node, node.jz)
        one = Column(one.x + node.gx, one.z + node.gz, one.phi)
        _add_lateral(rest, node)
        # The segment between nodes k and i: X_i = X_k + s and phi_k = a.s; s is eliminated.
        k = i - 1
        tx, tz, length = s.direction[k, 0], s.direction[k, 1], s.length[k]
        force, moment = s.force[k], s.moment[k]
        ax, az = -tz / length, tx / length
        bx, bz = xf + ax * ff, zf + az * ff
        x, z = (xx + ax * xf, xz + az * xf), (xz + ax * zf, zz + az * zf)
        # Its tangent: stretch, bending and the turning of its force, the turning of its moments.
        stretch, bend = viscous * model.rod.axial[k], viscous * model.rod.bending[k]
        across = bend + force * length
        twist = (moment - s.moment[i]) / length
        p = _inverse(
            x[0] + bx * ax + stretch * tx * tx + across * ax * ax - 2.0 * twist * tx * ax,
            z[0] + bx * az + stretch * tx * tz + across * ax * az - twist * (tx * az + tz * ax),
            z[1] + bz * az + stretch * tz * tz + across * az * az - 2.0 * twist * tz * az,
        )
        definite &= p.positive
        # Right-hand sides r and solutions w: how s follows each of the other unknowns.
        along, around = model.tendon.along[k], model.tendon.around[k]
        phi = (-bend * ax, -bend * az)
        r1, r2, r3 = _lift(q1, ax, az), _lift(q2, ax, az), _lift(q3, ax, az)
        rc, ro = _lift(cable, ax, az), _lift(one, ax, az)
        rc = (rc[0] + along * tx + around * ax, rc[1] + along * tz + around * az)
        ro = (ro[0] + force * tx + moment * ax, ro[1] + force * tz + moment * az)
        wx, wz, wf = _over(p, x), _over(p, z), _over(p, phi)
        w1, w2, w3, wc, wo = _over(p, r1), _over(p, r2), _over(p, r3), _over(p, rc), _over(p, ro)
        _store(work.back[leg, k], wx, wz, wf, w1, w2, w3, wc, wo)
        # What is left acts on node k and on the segment before it.
        q1, q2, q3 = _fold(q1, x, z, phi, w1), _fold(q2, x, z, phi, w2), _fold(q3, x, z, phi, w3)
        cable, one = _fold(cable, x, z, phi, wc), _fold(one, x, z, phi, wo)
        cable = Column(cable.x, cable.z, cable.phi - around)
        one = Column(one.x, one.z, one.phi - moment)
        xx, xz, zz = xx - _dot(x, wx), xz - _dot(x, wz), zz - _dot(z, wz)
        xf, zf, ff = -_dot(x, wf), -_dot(z, wf), bend - _dot(phi, wf)
        _gather(rest, r1, r2, r3, rc, w1, w2, w3, wc, wo)
        work.lever[leg, k, 0], work.lever[leg, k, 1] = ax, az
    node = _node(model, work, leg, 0, inv, height)
    xx, xz, zz = xx + node.cxx, xz + node.cxz, zz + node.czz
    _add_lateral(rest, node)
    one = Column(one.x + node.gx, one.z + node.gz, one.phi)
    F = work.form
    F[0, 0], F[0, 1], F[0, 2], F[1, 1], F[1, 2], F[2, 2] = xx, xz, xf, zz, zf, ff
    _write(F, 3, q1)
    _write(F, 4, q2)
    _write(F, 5, q3)
    _write(F, 6, cable)
    _write(F, 7, one)
    for r in range(4):
        for c in range(r, 5):
            F[3 + r, 3 + c] = rest[r, c]
    for r in range(1, 7):
        for c in range(r):
            F[r, c] = F[c, r]
    return definite


@helper
def _node(model, work, leg, i, inv, height):  # type: ignore[no-untyped-def]
    """Inertia, weight and contact of a node."""
    u, before, g, up = (
        work.velocity[leg, i],
        work.before[leg, i],
        work.leg_field[1],
        work.leg_field[0],
    )
    rx, ry, rz = _triple(model.root[leg])
    rx, rz = rx + work.stage[leg, i, 0], rz + work.stage[leg, i, 1]
    mass = model.rod.mass[i]
    gx = mass * ((u[0] - before[0]) * inv - g[0])
    gy = mass * ((u[1] - before[1]) * inv - g[1])
    gz = mass * ((u[2] - before[2]) * inv - g[2])
    inertia = mass * inv * inv
    gap = height + up[0] * rx + up[1] * ry + up[2] * rz
    if gap < 0.0 and i > 0:  # the clamp is inside the torso, whose corners touch the floor
        vn = up[0] * u[0] + up[1] * u[1] + up[2] * u[2]
        normal, drag = touch(model.floor, model.friction[leg], gap, vn, u[0], u[1], u[2])
        if normal > 0.0:
            stiff = model.floor.stiffness + (model.floor.damping - drag) * inv
            inertia += drag * inv
            return Node(
                inertia + stiff * up[0] * up[0],
                stiff * up[0] * up[1],
                stiff * up[0] * up[2],
                inertia + stiff * up[1] * up[1],
                stiff * up[1] * up[2],
                inertia + stiff * up[2] * up[2],
                gx - up[0] * (normal + drag * vn) + drag * u[0],
                gy - up[1] * (normal + drag * vn) + drag * u[1],
                gz - up[2] * (normal + drag * vn) + drag * u[2],
                -rz,
                rx,
            )
    return Node(inertia, 0.0, 0.0, inertia, 0.0, inertia, gx, gy, gz, -rz, rx)


@helper
def _add(column, node, share):  # type: ignore[no-untyped-def]
    """Add to a column of q what a node couples between its plane and y."""
    return Column(column.x + node.cxy * share, column.z + node.cyz * share, column.phi)


@helper
def _add_lateral(rest, node):  # type: ignore[no-untyped-def]
    """Add what a node gives to q alone."""
    x, z, c = node.jx, node.jz, node.cyy
    rest[0, 0] += c
    rest[0, 1] += c * x
    rest[0, 2] += c * z
    rest[1, 1] += c * x * x
    rest[1, 2] += c * x * z
    rest[2, 2] += c * z * z
    rest[0, 4] += node.gy
    rest[1, 4] += node.gy * x
    rest[2, 4] += node.gy * z


@helper
def _inverse(xx, xz, zz):  # type: ignore[no-untyped-def]
    det = xx * zz - xz * xz
    scale = 1.0 / det
    return Pivot(zz * scale, -xz * scale, xx * scale, det > 0.0 and xx > 0.0)


@helper
def _over(p, r):  # type: ignore[no-untyped-def]
    """The inverse p times r."""
    return p.xx * r[0] + p.xz * r[1], p.xz * r[0] + p.zz * r[1]


@helper
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1]


@helper
def _lift(column, ax, az):  # type: ignore[no-untyped-def]
    """Right-hand side of s from a column, with phi = a.s."""
    return column.x + ax * column.phi, column.z + az * column.phi


@helper
def _fold(column, x, z, phi, w):  # type: ignore[no-untyped-def]
    """A column after the elimination of s, which follows its unknown with -w."""
    return Column(column.x - _dot(x, w), column.z - _dot(z, w), -_dot(phi, w))


@helper
def _gather(rest, r1, r2, r3, rc, w1, w2, w3, wc, wo):  # type: ignore[no-untyped-def]
    """Subtract r.w from the form over (q, lambda | 1), upper half."""
    rest[0, 0] -= _dot(r1, w1)
    rest[0, 1] -= _dot(r1, w2)
    rest[0, 2] -= _dot(r1, w3)
    rest[0, 3] -= _dot(r1, wc)
    rest[0, 4] -= _dot(r1, wo)
    rest[1, 1] -= _dot(r2, w2)
    rest[1, 2] -= _dot(r2, w3)
    rest[1, 3] -= _dot(r2, wc)
    rest[1, 4] -= _dot(r2, wo)
    rest[2, 2] -= _dot(r3, w3)
    rest[2, 3] -= _dot(r3, wc)
    rest[2, 4] -= _dot(r3, wo)
    rest[3, 3] -= _dot(rc, wc)
    rest[3, 4] -= _dot(rc, wo)


@helper
def _store(back, wx, wz, wf, w1, w2, w3, wc, wo):  # type: ignore[no-untyped-def]
    """Keep how s follows (X, phi, q, lambda, 1) for the substitution."""
    for r in range(2):
        back[r, 0], back[r, 1], back[r, 2] = wx[r], wz[r], wf[r]
        back[r, 3], back[r, 4], back[r, 5] = w1[r], w2[r], w3[r]
        back[r, 6], back[r, 7] = wc[r], wo[r]


@helper
def _write(form, c, column):  # type: ignore[no-untyped-def]
    form[0, c], form[1, c], form[2, c] = column.x, column.z, column.phi


@helper
def couple(model, work, leg, inv):  # type: ignore[no-untyped-def]
    """Eliminate lambda and add the leg's form to the torso's system."""
    F, tendon, release = work.form, model.tendon, work.release[leg]
    stiffness = tendon.stiffness + tendon.damping * inv if work.tension[leg] > 0.0 else 0.0
    factor = stiffness / (1.0 - stiffness * F[6, 6])
    for c in range(6):
        release[c] = factor * F[6, c]
    release[6] = factor * F[6, 7]
    reduced, half, L = work.reduced, work.product, model.clamp[leg]
    for r in range(6):
        for c in range(6):
            reduced[r, c] = F[r, c] + F[r, 6] * release[c]
        reduced[r, 6] = F[r, 7] + F[r, 6] * release[6]
    for r in range(6):
        for c in range(6):
            value = 0.0
            for k in range(6):
                value += reduced[r, k] * L[k, c]
            half[r, c] = value
        half[r, 6] = reduced[r, 6]
    for r in range(6):
        for k in range(6):
            work.vector[r] += L[k, r] * half[k, 6]
            for c in range(6):
                work.matrix[r, c] += L[k, r] * half[k, c]


@helper
def substitute(model, work, leg, inv):  # type: ignore[no-untyped-def]
    """Carry the torso's increments through a leg and update V; returns the largest |change|^2."""
    largest = 0.0
    L, x, release = model.clamp[leg], work.vector, work.release[leg]
    rx, _, rz = _triple(model.root[leg])
    z = work.moved
    z[7] = 1.0
    z[6] = release[6]
    for r in range(6):
        value = 0.0
        for c in range(6):
            value += L[r, c] * x[c]
        z[r] = value
        z[6] += release[r] * value
    work.tension[leg] = max(0.0, work.tension[leg] + z[6])
    for i in range(work.stage.shape[1]):
        if i > 0:
            follow(z, work.back[leg, i - 1], work.lever[leg, i - 1])
        u, stage = work.velocity[leg, i], work.stage[leg, i]
        u[0] += z[0] * inv
        u[1] += (z[3] + (rx + stage[0]) * z[5] - (rz + stage[1]) * z[4]) * inv
        u[2] += z[1] * inv
        largest = max(largest, (z[0] * z[0] + z[1] * z[1]) * inv * inv)
    return largest


@helper
def follow(z, back, lever):  # type: ignore[no-untyped-def]
    """Replace X and phi in z (8,), which begin a segment, by those at its end."""
    sx = sz = 0.0
    for c in range(8):
        sx -= back[0, c] * z[c]
        sz -= back[1, c] * z[c]
    z[0] += sx
    z[1] += sz
    z[2] = lever[0] * sx + lever[1] * sz


@helper
def _finish(model, state, work, h, theta):  # type: ignore[no-untyped-def]
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
def _move(state, work, h):  # type: ignore[no-untyped-def]
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
    _orthonormalise(state.rotation, work.spare[1])


@helper
def _orthonormalise(out, r):  # type: ignore[no-untyped-def]
    """out = r (3 I - r^T r) / 2, which takes rounding errors out of a rotation."""
    for i in range(3):
        for j in range(3):
            value = 1.5 * r[i, j]
            for k in range(3):
                dot = r[0, k] * r[0, j] + r[1, k] * r[1, j] + r[2, k] * r[2, j]
                value -= 0.5 * r[i, k] * dot
            out[i, j] = value


@helper
def _finish_leg(model, state, work, leg, h, theta):  # type: ignore[no-untyped-def]
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
