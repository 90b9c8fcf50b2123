"""Quantities computed from a state: node positions, ground forces, momentum, energy.

The masses of a segment move linearly between its nodes (`rod.py`). With its coupling mu, spin
inertia I, chord e, difference of its nodes' velocities u and swirl S it adds to the lumped masses

    angular momentum I S - mu e x u,      kinetic energy (I S.S - mu u.u) / 2.

`points` writes position and velocity of the nodes, which the other kernels take.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math

from slot_core.compiled import helper, kernel
from slot_core.dynamics.algebra import (
    add,
    cross,
    dot,
    minus,
    plus,
    put,
    row,
    scaled,
    times,
    times_transposed,
)
from slot_core.dynamics.contact import coefficient, friction_force, normal_force
from slot_core.dynamics.spatial.strain import elastic_energy
from slot_core.dynamics.tendon import cable_energy
from slot_core.dynamics.terrain import ground, is_uneven


@kernel
def points(model, state, position, velocity):
    """Write position (4, N, 3) and velocity (4, N, 3) of all nodes, odom, m and m/s."""
    for leg in range(4):
        for i in range(state.node.shape[1]):
            from_centre = add(model.root[leg], state.node[leg, i])
            from_centre = _to_odom(model, state, leg, from_centre)
            put(position[leg], i, add(state.position, from_centre))
            own = _to_odom(model, state, leg, state.node_velocity[leg, i])
            put(velocity[leg], i, own)


@helper
def _to_odom(model, state, leg, v):
    """A vector in leg axes, in odom."""
    return times(state.rotation, times_transposed(model.axes[leg], v))


@helper
def _contact_point(model, state, position, velocity, leg, p):
    """Node of contact point p of a leg, its position and velocity, odom, m and m/s.

    The points of a leg are numbered as in `contact.Floor`. A segment turns with
    w = e x u / e.e + S, its chord e, difference of velocities u and swirl S.
    """
    reach = model.floor.half_width
    k = p // 4
    i = p // 4 + (p // 2) % 2
    if p % 2 == 0:
        reach = -reach
    r, v = position[leg], velocity[leg]
    arm = _to_odom(model, state, leg, scaled(reach, state.director[leg, k]))
    e = minus(row(r, k + 1), row(r, k))
    w = cross(e, minus(row(v, k + 1), row(v, k)))
    w = plus(
        _to_odom(model, state, leg, state.swirl[leg, k]), 1.0 / dot(e, e), w
    )
    return i, add(row(r, i), arm), add(row(v, i), cross(w, arm))


@kernel
def ground_forces(model, state, position, velocity, force):
    """Write the force (4, 3), N, odom, of the floor on each leg.

    The sum over its contact points of N n - drag v - held (`contact.py`), without growth of the
    bristles within a step.
    """
    force[:] = 0.0
    floor, friction = model.floor, model.friction
    for leg in range(4):
        own, other = friction[0, leg], friction[1, leg]
        for p in range(floor.stiffness.size):
            i, place, u = _contact_point(
                model, state, position, velocity, leg, p
            )
            gap, up = _gap(floor.terrain, place)
            if i < floor.first or gap >= 0.0:
                continue
            vn = dot(up, u)
            v = plus(u, -vn, up)
            stiffness, damping = floor.stiffness[p], floor.damping[p]
            normal = normal_force(stiffness, damping, gap, vn)
            outward = times(
                model.axes[leg], times_transposed(state.rotation, v)
            )[0]
            rate = state.tendon_rate[leg]
            mu = coefficient(floor, own, other, rate, outward, dot(v, v))
            bristle = v
            if floor.bristle > 0.0:
                bristle = row(state.bristle[leg], p)
            most = mu * normal
            hold = friction_force(
                floor, most, 0.0, stiffness, damping, bristle, v
            )
            f = minus(
                minus(scaled(normal, up), scaled(hold.drag, v)), hold.held
            )
            put(force, leg, add(row(force, leg), f))


@helper
def _gap(terrain, r):
    """Gap (m) of a point in odom and the floor's normal there."""
    if not is_uneven(terrain):
        return r[2], (0.0, 0.0, 1.0)
    below = ground(terrain, r[0], r[1])
    a, b = below.slope_x, below.slope_y
    tall = 1.0 / math.sqrt(1.0 + a * a + b * b)
    return (r[2] - below.height) * tall, (-a * tall, -b * tall, tall)


@kernel
def momenta(model, state, position, velocity, out):
    """Write out (2, 3): momentum (kg m/s) and angular momentum about odom's origin (kg m^2/s).

    Of torso, payload and legs; bristles and cables have no mass.
    """
    out[:] = 0.0
    _add_momentum(out, model.torso.mass, state.position, state.velocity)
    _add_momentum(out, model.payload[0], *_payload(model, state))
    spinning = times(state.rotation, times(model.torso.inertia, state.rate))
    put(out, 1, add(row(out, 1), spinning))
    for leg in range(4):
        r, v = position[leg], velocity[leg]
        for i in range(r.shape[0]):
            _add_momentum(out, model.rod.mass[i], row(r, i), row(v, i))
        for k in range(r.shape[0] - 1):
            # The masses between two nodes move linearly; the segment spins about itself.
            e = minus(row(r, k + 1), row(r, k))
            arm = cross(e, minus(row(v, k + 1), row(v, k)))
            spin = scaled(model.rod.spin[k], state.swirl[leg, k])
            spin = _to_odom(model, state, leg, spin)
            own = minus(spin, scaled(model.rod.coupling[k], arm))
            put(out, 1, add(row(out, 1), own))


@helper
def _add_momentum(out, mass, r, v):
    """Add m v and m r x v."""
    put(out, 0, plus(row(out, 0), mass, v))
    put(out, 1, plus(row(out, 1), mass, cross(r, v)))


@kernel
def energy(model, state, segments, position, velocity):
    """J: kinetic, gravity (zero at odom's origin), rods, cables, floor and bristles.

    segments: scratch arrays of one rod.
    """
    floor = model.floor
    total = 0.5 * dot(state.rate, times(model.torso.inertia, state.rate))
    total += _point_energy(
        model, model.torso.mass, state.position, state.velocity
    )
    total += _point_energy(model, model.payload[0], *_payload(model, state))
    total += _corner_energy(model, state)
    for leg in range(4):
        total += _leg_energy(
            model, state, segments, position[leg], velocity[leg], leg
        )
        for p in range(floor.stiffness.size):
            i, place, _ = _contact_point(
                model, state, position, velocity, leg, p
            )
            if i >= floor.first:
                stiffness, bristle = floor.stiffness[p], state.bristle[leg]
                total = _add_contact(total, floor, stiffness, place, bristle, p)
    return total


@helper
def _leg_energy(model, state, segments, position, velocity, leg):
    """J, of the rod and its cable, and of the motion and weight of its masses."""
    rod, angle = model.rod, state.tendon_angle[leg]
    total = elastic_energy(segments, rod, state.node[leg], state.director[leg])
    fault = (model.fault[0, leg], model.fault[1, leg])
    total += cable_energy(segments, model.tendon, angle, fault)
    for i in range(position.shape[0]):
        total += _point_energy(
            model, rod.mass[i], row(position, i), row(velocity, i)
        )
    for k in range(position.shape[0] - 1):
        u = minus(row(velocity, k + 1), row(velocity, k))
        s = row(state.swirl[leg], k)
        total += 0.5 * (rod.spin[k] * dot(s, s) - rod.coupling[k] * dot(u, u))
    return total


@helper
def _payload(model, state):
    """Position and velocity of the payload in odom."""
    p = (model.payload[1], model.payload[2], model.payload[3])
    turning = times(state.rotation, cross(state.rate, p))
    place = add(state.position, times(state.rotation, p))
    return place, add(state.velocity, turning)


@helper
def _corner_energy(model, state):
    """J, floor springs and bristles of the torso's corners."""
    total, floor = 0.0, model.floor
    for k in range(model.torso.corners.shape[0]):
        r = add(
            state.position, times(state.rotation, row(model.torso.corners, k))
        )
        stiffness, bristle = floor.corner_stiffness, state.corner_bristle
        total = _add_contact(total, floor, stiffness, r, bristle, k)
    return total


@helper
def _add_contact(total, floor, stiffness, r, bristle, p):
    """J, `total` and the energy of spring and bristle of a contact point at r, odom, m."""
    gap, _ = _gap(floor.terrain, r)
    total += 0.5 * stiffness * min(0.0, gap) ** 2
    if floor.bristle > 0.0:
        held = row(bristle, p)
        total += 0.5 * floor.bristle * stiffness * dot(held, held)
    return total


@helper
def _point_energy(model, mass, r, v):
    """J, of motion and weight of a point mass."""
    g = model.gravity
    kinetic = 0.5 * dot(v, v)
    return mass * (kinetic - g[0] * r[0] - g[1] * r[1] - g[2] * r[2])
