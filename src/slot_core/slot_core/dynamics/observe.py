"""What can be read off a state: positions, ground forces, momentum, energy."""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

from slot_core.dynamics.algebra import times, times_transposed
from slot_core.dynamics.compiled import helper, kernel
from slot_core.dynamics.contact import touch
from slot_core.dynamics.rod import elastic_energy, measure
from slot_core.dynamics.tendon import cable_energy


@kernel
def points(model, state, position, velocity):
    """Write position (4, N, 3) and velocity (4, N, 3) of all nodes, odom, m and m/s."""
    for leg in range(4):
        root = model.root[leg]
        for i in range(state.node.shape[1]):
            x, z = state.node[leg, i, 0], state.node[leg, i, 1]
            px, py, pz = _to_odom(model, state, leg, root[0] + x, root[1], root[2] + z)
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


@kernel
def ground_forces(model, position, velocity, force):
    """Write force (4, 3), N, odom: what the floor exerts on the nodes of each leg."""
    force[:] = 0.0
    for leg in range(4):
        for i in range(1, position.shape[1]):
            vx, vy, vz = velocity[leg, i, 0], velocity[leg, i, 1], velocity[leg, i, 2]
            mu, gap = model.friction[leg], position[leg, i, 2]
            normal, drag = touch(model.floor, mu, gap, vz, vx, vy, vz)
            force[leg, 0] -= drag * vx
            force[leg, 1] -= drag * vy
            force[leg, 2] += normal


@kernel
def momenta(model, state, position, velocity, out):
    """Write out (2, 3): momentum (kg m/s) and angular momentum about odom's origin (kg m^2/s)."""
    out[:] = 0.0
    _add_momentum(out, model.torso.mass, state.position, state.velocity)
    w = state.rate
    lx, ly, lz = times(model.torso.inertia, w[0], w[1], w[2])
    lx, ly, lz = times(state.rotation, lx, ly, lz)
    out[1, 0] += lx
    out[1, 1] += ly
    out[1, 2] += lz
    for leg in range(4):
        for i in range(position.shape[1]):
            _add_momentum(out, model.rod.mass[i], position[leg, i], velocity[leg, i])


@helper
def _add_momentum(out, mass, r, v):
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[0, i] += mass * v[i]
        out[1, i] += mass * (r[j] * v[k] - r[k] * v[j])


@kernel
def energy(model, state, segments, position, velocity):
    """J: kinetic, gravity (zero at odom's origin), rods, cables, floor springs below the legs."""
    w = state.rate
    lx, ly, lz = times(model.torso.inertia, w[0], w[1], w[2])
    total = 0.5 * (w[0] * lx + w[1] * ly + w[2] * lz)
    total += _point_energy(model, model.torso.mass, state.position, state.velocity)
    for leg in range(4):
        # turning rates are not used: any rate of the clamp will do
        measure(segments, state.node[leg], state.node_velocity[leg], 0.0, 0.0)
        total += elastic_energy(segments, model.rod)
        total += cable_energy(segments, model.tendon, state.tendon_angle[leg])
        for i in range(position.shape[1]):
            total += _point_energy(model, model.rod.mass[i], position[leg, i], velocity[leg, i])
            gap = min(0.0, position[leg, i, 2]) if i > 0 else 0.0
            total += 0.5 * model.floor.stiffness * gap * gap
    return total


@helper
def _point_energy(model, mass, r, v):
    g = model.gravity
    kinetic = 0.5 * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return mass * (kinetic - g[0] * r[0] - g[1] * r[1] - g[2] * r[2])
