"""Positions and velocities of the nodes, and ground forces, computed from a state."""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import numpy as np

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
from slot_core.dynamics.contact import (
    clearance,
    coefficient,
    friction_force,
    normal_force,
)
from slot_core.dynamics.handle import contents
from slot_core.matrices import set_product

ORIGIN, AXES = np.zeros(3), np.eye(3)  # of odom


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
    half, k = model.floor.half_width, p // 4
    i, reach = k + (p // 2) % 2, half if p % 2 else -half
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
            gap, up, _ = clearance(floor.terrain, ORIGIN, AXES, place)
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


@kernel
def everything(machine, position, velocity, force, turn, director):
    """Write `points`, `ground_forces` and directors (4, N-1, 3) in odom of the robot at a handle.

    machine: as of `integrator.advance`; turn (3, 3) is overwritten.
    """
    model, state, _, _, _, _ = contents(machine)
    points(model, state, position, velocity)
    ground_forces(model, state, position, velocity, force)
    for leg in range(4):
        set_product(turn, model.axes[leg], state.rotation.T)
        set_product(director[leg], state.director[leg], turn)
