"""Quantities computed from a state: node positions, ground forces, momentum, energy."""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math

from slot_core.compiled import helper, kernel
from slot_core.dynamics.algebra import cross, dot, plus, row, times, times_transposed
from slot_core.dynamics.contact import coefficient, friction_force, normal_force
from slot_core.dynamics.spatial.strain import elastic_energy
from slot_core.dynamics.tendon import cable_energy
from slot_core.dynamics.terrain import ground, is_uneven


@kernel
def points(model, state, position, velocity):
    """Write position (4, N, 3) and velocity (4, N, 3) of all nodes, odom, m and m/s."""
    for leg in range(4):
        root = model.root[leg]
        for i in range(state.node.shape[1]):
            r = state.node[leg, i]
            x, y, z = root[0] + r[0], root[1] + r[1], root[2] + r[2]
            px, py, pz = _to_odom(model, state, leg, x, y, z)
            out = position[leg, i]
            out[0] = state.position[0] + px
            out[1] = state.position[1] + py
            out[2] = state.position[2] + pz
            u, out = state.node_velocity[leg, i], velocity[leg, i]
            out[0], out[1], out[2] = _to_odom(model, state, leg, u[0], u[1], u[2])


@helper
def _to_odom(model, state, leg, x, y, z):
    bx, by, bz = times_transposed(model.axes[leg], x, y, z)
    return times(state.rotation, bx, by, bz)


@helper
def _contact_point(model, state, position, velocity, leg, p):
    """Node of contact point p of a leg, its position and velocity, odom, m and m/s."""
    reach, k, i = model.floor.half_width, p // 4, p // 4 + (p // 2) % 2
    if p % 2 == 0:
        reach = -reach
    d, s = state.director[leg, k], state.swirl[leg, k]
    arm = _to_odom(model, state, leg, reach * d[0], reach * d[1], reach * d[2])
    a, b = row(position[leg], k), row(position[leg], k + 1)
    e = plus(b, -1.0, a)
    w = cross(e, plus(row(velocity[leg], k + 1), -1.0, row(velocity[leg], k)))
    w = plus(_to_odom(model, state, leg, s[0], s[1], s[2]), 1.0 / dot(e, e), w)
    return (
        i,
        plus(row(position[leg], i), 1.0, arm),
        plus(row(velocity[leg], i), 1.0, cross(w, arm)),
    )


@kernel
def ground_forces(model, state, position, velocity, force):
    """Write the force (4, 3), N, odom, of the floor on each leg."""
    force[:] = 0.0
    floor, friction = model.floor, model.friction
    for leg in range(4):
        for p in range(floor.stiffness.size):
            i, place, u = _contact_point(model, state, position, velocity, leg, p)
            gap, up = _gap(floor.terrain, place)
            if i < floor.first or gap >= 0.0:
                continue
            vn = up[0] * u[0] + up[1] * u[1] + up[2] * u[2]
            v = (u[0] - vn * up[0], u[1] - vn * up[1], u[2] - vn * up[2])
            slip = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
            stiffness, damping = floor.stiffness[p], floor.damping[p]
            normal = normal_force(stiffness, damping, gap, vn)
            outward = _outward(model, state, leg, v)
            rate = state.tendon_rate[leg]
            mu = coefficient(
                floor, friction[0, leg], friction[1, leg], rate, outward, slip
            )
            bristle = v
            if floor.bristle > 0.0:
                held = state.bristle[leg, p]
                bristle = (held[0], held[1], held[2])
            hold = friction_force(
                floor, mu * normal, 0.0, stiffness, damping, bristle, v
            )
            force[leg, 0] += normal * up[0] - hold.drag * v[0] - hold.x
            force[leg, 1] += normal * up[1] - hold.drag * v[1] - hold.y
            force[leg, 2] += normal * up[2] - hold.drag * v[2] - hold.z


@helper
def _gap(terrain, r):
    """Gap (m) of a point in odom and the floor's normal there."""
    if not is_uneven(terrain):
        return r[2], (0.0, 0.0, 1.0)
    below = ground(terrain, r[0], r[1])
    a, b = below.slope_x, below.slope_y
    tall = 1.0 / math.sqrt(1.0 + a * a + b * b)
    return (r[2] - below.height) * tall, (-a * tall, -b * tall, tall)


@helper
def _outward(model, state, leg, v):
    """Component of a velocity (odom) along a leg's x axis."""
    x, y, z = times_transposed(state.rotation, v[0], v[1], v[2])
    return times(model.axes[leg], x, y, z)[0]


@kernel
def momenta(model, state, position, velocity, out):
    """Write out (2, 3): momentum (kg m/s) and angular momentum about odom's origin (kg m^2/s)."""
    out[:] = 0.0
    _add_momentum(out, model.torso.mass, state.position, state.velocity)
    _add_momentum(out, model.payload[0], *_payload(model, state))
    w = state.rate
    lx, ly, lz = times(model.torso.inertia, w[0], w[1], w[2])
    lx, ly, lz = times(state.rotation, lx, ly, lz)
    out[1, 0] += lx
    out[1, 1] += ly
    out[1, 2] += lz
    for leg in range(4):
        for i in range(position.shape[1]):
            _add_momentum(out, model.rod.mass[i], position[leg, i], velocity[leg, i])
        for k in range(position.shape[1] - 1):
            # The masses between two nodes move linearly; the segment spins about itself.
            e = plus(row(position[leg], k + 1), -1.0, row(position[leg], k))
            u = plus(row(velocity[leg], k + 1), -1.0, row(velocity[leg], k))
            arm, s, inertia = cross(e, u), state.swirl[leg, k], model.rod.spin[k]
            s = _to_odom(
                model, state, leg, inertia * s[0], inertia * s[1], inertia * s[2]
            )
            for i in range(3):
                out[1, i] += s[i] - model.rod.coupling[k] * arm[i]


@helper
def _add_momentum(out, mass, r, v):
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[0, i] += mass * v[i]
        out[1, i] += mass * (r[j] * v[k] - r[k] * v[j])


@kernel
def energy(model, state, segments, position, velocity):
    """J: kinetic, gravity (zero at odom's origin), rods, cables, floor and bristles."""
    w = state.rate
    lx, ly, lz = times(model.torso.inertia, w[0], w[1], w[2])
    total = 0.5 * (w[0] * lx + w[1] * ly + w[2] * lz)
    total += _point_energy(model, model.torso.mass, state.position, state.velocity)
    total += _point_energy(model, model.payload[0], *_payload(model, state))
    total += _corner_energy(model, state)
    for leg in range(4):
        total += _leg_energy(model, state, segments, position[leg], velocity[leg], leg)
        for p in range(model.floor.stiffness.size):
            i, place, _ = _contact_point(model, state, position, velocity, leg, p)
            if i < model.floor.first:
                continue
            gap, _ = _gap(model.floor.terrain, place)
            total += 0.5 * model.floor.stiffness[p] * min(0.0, gap) ** 2
            if model.floor.bristle > 0.0:
                total += _bristle_energy(
                    model.floor, model.floor.stiffness[p], state.bristle[leg, p]
                )
    return total


@helper
def _leg_energy(model, state, segments, position, velocity, leg):
    """J, of the rod and its cable, and of the motion and weight of its masses."""
    rod, angle = model.rod, state.tendon_angle[leg]
    total = elastic_energy(segments, rod, state.node[leg], state.director[leg])
    fault = (model.fault[0, leg], model.fault[1, leg])
    total += cable_energy(segments, model.tendon, angle, fault)
    for i in range(position.shape[0]):
        total += _point_energy(model, rod.mass[i], position[i], velocity[i])
    for k in range(position.shape[0] - 1):
        u, s = (
            plus(row(velocity, k + 1), -1.0, row(velocity, k)),
            row(state.swirl[leg], k),
        )
        total += 0.5 * (rod.spin[k] * dot(s, s) - rod.coupling[k] * dot(u, u))
    return total


@helper
def _payload(model, state):
    """Position and velocity of the payload in odom."""
    _, x, y, z = model.payload
    w = state.rate
    px, py, pz = times(state.rotation, x, y, z)
    u = times(
        state.rotation, w[1] * z - w[2] * y, w[2] * x - w[0] * z, w[0] * y - w[1] * x
    )
    r, v = state.position, state.velocity
    return (r[0] + px, r[1] + py, r[2] + pz), (v[0] + u[0], v[1] + u[1], v[2] + u[2])


@helper
def _corner_energy(model, state):
    """J, floor springs and bristles of the torso's corners."""
    total, stiffness = 0.0, model.floor.corner_stiffness
    for k in range(model.torso.corners.shape[0]):
        c = model.torso.corners[k]
        x, y, z = times(state.rotation, c[0], c[1], c[2])
        r = (state.position[0] + x, state.position[1] + y, state.position[2] + z)
        gap, _ = _gap(model.floor.terrain, r)
        total += 0.5 * stiffness * min(0.0, gap) ** 2
        if model.floor.bristle > 0.0:
            total += _bristle_energy(model.floor, stiffness, state.corner_bristle[k])
    return total


@helper
def _bristle_energy(floor, stiffness, held):
    square = held[0] * held[0] + held[1] * held[1] + held[2] * held[2]
    return 0.5 * floor.bristle * stiffness * square


@helper
def _point_energy(model, mass, r, v):
    g = model.gravity
    kinetic = 0.5 * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return mass * (kinetic - g[0] * r[0] - g[1] * r[1] - g[2] * r[2])
