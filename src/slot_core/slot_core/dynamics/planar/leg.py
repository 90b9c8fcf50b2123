"""A planar leg within a time step: prediction, stage, strains and tension, end of the step.

The unknowns are the velocities of the nodes in the leg's plane. Normal to the plane a node moves
with the torso, V_y = v_y + (omega x rho)_y, so its lateral inertia and contact are added to the
torso.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

from typing import NamedTuple

from slot_core.compiled import helper
from slot_core.dynamics.algebra import product, rotation, times
from slot_core.dynamics.contact import advance_bristle
from slot_core.dynamics.lanes import like
from slot_core.dynamics.planar.strain import PlanarSegments, load, measure
from slot_core.dynamics.servo import spool_rate
from slot_core.dynamics.tendon import pull, stretch_line
from slot_core.robot import Array


class PlanarLeg(NamedTuple):
    """Parameters, state views and scratch arrays of one leg in leg axes; no step allocates memory.

    The arrays of four legs have one axis more, the last (`lanes.py`). "Step axes" are those of
    `integrator.py`.
    """

    axes: Array  # (3, 3) base_link to leg axes
    root: Array  # (3,) m, clamp from the torso's centre
    clamp: Array  # (6, 6) torso increments to the displacements (X, phi, q) of the clamp
    friction: Array  # (2,) as in Model
    fault: Array  # (2,) as in Model
    node: Array  # (N, 3), node_velocity (N, 3), angle, rate, tension (1,): views of the state
    node_velocity: Array
    angle: Array
    rate: Array
    tension: Array
    drive: Array  # (3,), bristle (N, 3): views of the state
    bristle: Array
    command: Array  # (1,) rad, commanded tendon angle
    stage: Array  # (N, 2) m, node at the stage
    velocity: Array  # (N, 3) m/s, V
    before: Array  # (N, 3) m/s, V_n in step axes
    base: Array  # (N, 2) m, stage position without the part due to V
    segments: PlanarSegments
    form: Array  # (7, 8) F
    rest: Array  # (4, 5) form over (q, lambda | 1), upper half
    moved: Array  # (6,) displacements of the clamp
    back: Array  # (N-1, 2, 8) rows for the substitution
    pull: Array  # (1,) N, tension at the iterate
    line: Array  # (3,) direction and 1 / length of a straight tendon
    limit: Array  # (N or 0,) N, mu times the normal force
    slope: Array  # (N or 0, 2) of the floor below
    release: Array  # (7,) lambda = release . (displacements of the clamp, 1)
    reduced: Array  # (6, 7) form over the displacements of the clamp
    product: Array  # (6, 6)
    turns: Array  # (3, 3) rotation by -(1 - theta) h omega_n
    whole: Array  # (3, 3) scratch rotations
    back_turn: Array  # (3, 3)
    forth: Array  # (3, 3)
    motion: Array  # (3, 3) torso in leg axes: v, omega, theta h (omega - omega_n)
    field: Array  # (4, 3) odom's axes and gravity in leg axes


@helper
def predict(model, state, leg, h, theta):
    """The servo's rate, V_n in step axes, and the stage positions without the part due to V."""
    torque = model.tendon.spool_radius * leg.tension[0]
    leg.rate[0] = spool_rate(model.servo, leg.drive, leg.command[0], leg.angle[0], torque, h)
    w, root = state.rate, leg.root
    wx, wy, wz = times(leg.axes, w[0], w[1], w[2])
    to_stage, to_end = leg.forth, leg.whole
    rotation(to_stage, -theta * h * wx, -theta * h * wy, -theta * h * wz)
    rotation(to_end, -h * wx, -h * wy, -h * wz)
    rest = (theta - 1.0) * h
    rotation(leg.turns, rest * wx, rest * wy, rest * wz)
    rx, ry, rz = root[0], root[1], root[2]
    for i in range(leg.node.shape[0]):
        u = leg.node_velocity
        ux, uy, uz = times(to_stage, u[i, 0], u[i, 1], u[i, 2])
        leg.velocity[i, 0], leg.velocity[i, 1], leg.velocity[i, 2] = ux, uy, uz
        leg.before[i, 0], leg.before[i, 1], leg.before[i, 2] = ux, uy, uz
        x, z = leg.node[i, 0], leg.node[i, 2]
        ex, _, ez = times(to_end, rx + x, ry, rz + z)
        leg.base[i, 0] = (1.0 - theta) * x + theta * (ex - rx)
        leg.base[i, 1] = (1.0 - theta) * z + theta * (ez - rz)


@helper
def stage(leg, tau):
    """Stage positions of a leg, m, and lateral velocities from the torso's motion, m/s."""
    stage, velocity, base, motion, q = leg.stage, leg.velocity, leg.base, leg.motion, leg.turns
    rx, ry, rz = leg.root[0], leg.root[1], leg.root[2]
    vx, vy, vz = motion[0, 0], motion[0, 1], motion[0, 2]
    wx, wy, wz = motion[1, 0], motion[1, 1], motion[1, 2]
    stage[0, 0] = motion[2, 1] * rz - motion[2, 2] * ry
    stage[0, 1] = motion[2, 0] * ry - motion[2, 1] * rx
    velocity[0, 0] = vx + wy * rz - wz * ry
    velocity[0, 1] = vy + wz * rx - wx * rz
    velocity[0, 2] = vz + wx * ry - wy * rx
    for i in range(1, stage.shape[0]):
        x, z = base[i, 0], base[i, 1]
        sway = wz * (rx + x) - wx * (rz + z)
        ux, _, uz = times(q, velocity[i, 0] - vx, sway, velocity[i, 2] - vz)
        stage[i, 0], stage[i, 1] = x + tau * ux, z + tau * uz
        velocity[i, 1] = vy + wz * (rx + stage[i, 0]) - wx * (rz + stage[i, 1])


@helper
def load_leg(model, leg, tau):
    """Geometry, tendon tension and internal forces of a leg at the iterate."""
    s = leg.segments
    rate, turned, turning = leg.rate[0], -leg.motion[2, 1], -leg.motion[1, 1]
    measure(s, model.rod, leg.stage, leg.velocity, turned, turning)
    line = (like(0.0, rate), like(0.0, rate))
    if model.tendon.straight:
        line = stretch_line(leg.line, model.tendon, leg.stage, leg.velocity, turned, turning)
    leg.pull[0] = pull(s, model.tendon, leg.angle[0] + tau * rate, rate, line, leg.fault)
    load(s, model.rod, model.tendon, leg.pull[0])


@helper
def advance_bristles(floor, leg, h):
    """Integrate the bristles of a leg's nodes over the step."""
    f = leg.field
    for i in range(floor.first, leg.velocity.shape[0]):
        ux, uy, uz = leg.velocity[i, 0], leg.velocity[i, 1], leg.velocity[i, 2]
        x = f[0, 0] * ux + f[0, 1] * uy + f[0, 2] * uz
        y = f[1, 0] * ux + f[1, 1] * uy + f[1, 2] * uz
        z = f[2, 0] * ux + f[2, 1] * uy + f[2, 2] * uz
        advance_bristle(
            floor, leg.bristle[i], leg.limit[i], floor.stiffness[i], leg.slope[i], h, x, y, z
        )


@helper
def finish(model, state, work, leg, h, theta):
    """Nodes in leg axes, tension and tendon angle at the end of the step; model: not used."""
    root, v, w, w0 = leg.root, work.motion[0], work.motion[1], state.rate
    wx, wy, wz = times(leg.axes, w[0], w[1], w[2])
    ox, oy, oz = times(leg.axes, w0[0], w0[1], w0[2])
    vx, vy, vz = times(leg.axes, v[0], v[1], v[2])
    whole, back, rest = leg.whole, leg.back_turn, leg.forth
    past = 1.0 / theta
    rotation(whole, -h * wx, -h * wy, -h * wz)
    rotation(back, theta * h * ox, theta * h * oy, theta * h * oz)
    product(rest, whole, back)
    rx, ry, rz = root[0], root[1], root[2]
    for i in range(leg.node.shape[0]):
        ux, uy, uz = leg.velocity[i, 0], leg.velocity[i, 1], leg.velocity[i, 2]
        px, py, pz = leg.before[i, 0], leg.before[i, 1], leg.before[i, 2]
        x, z = leg.node[i, 0], leg.node[i, 2]
        if i > 0:
            ax, _, az = times(whole, rx + x, ry, rz + z)
            dx, _, dz = times(rest, ux - vx, uy - vy, uz - vz)
            leg.node[i, 0] = ax + h * dx - rx
            leg.node[i, 2] = az + h * dz - rz
        ex, ey, ez = px + (ux - px) * past, py + (uy - py) * past, pz + (uz - pz) * past
        ex, ey, ez = times(rest, ex, ey, ez)
        out = leg.node_velocity
        out[i, 0], out[i, 1], out[i, 2] = ex, ey, ez
    leg.tension[0] = leg.pull[0]
    leg.angle[0] += h * leg.rate[0]
