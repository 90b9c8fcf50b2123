"""A spatial leg within a time step: prediction, stage, strains and tension, end of the step.

The unknowns of a step are the velocities of the nodes and the spins of the segments about
themselves. The spin's angular momentum is kept as a vector, I S with S = Omega t at the stage, so
that the angular momentum of a free rod is conserved to rounding by the midpoint rule.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

from typing import NamedTuple

from slot_core.arrays import Array
from slot_core.compiled import helper
from slot_core.dynamics.algebra import (
    cross,
    dot,
    plus,
    product,
    put,
    rotation,
    row,
    times,
)
from slot_core.dynamics.contact import advance_bristle
from slot_core.dynamics.servo import spool_rate
from slot_core.dynamics.spatial.floor_contact import angular_velocity
from slot_core.dynamics.spatial.relaxation import relax, remember
from slot_core.dynamics.spatial.strain import Segments, measure, orient, point_along
from slot_core.dynamics.tendon import pull


class SpatialLeg(NamedTuple):
    """Parameters, state views and scratch arrays of one leg in leg axes; no step allocates memory.

    The arrays of four legs have one axis more, the last (`lanes.py`). "Step axes" are those of
    `integrator.py`.
    """

    axes: Array  # (3, 3) base_link to leg axes
    root: Array  # (3,) m, clamp from the torso's centre
    clamp: Array  # (6, 6) torso increments to the displacements (X, Phi) of the clamp
    friction: Array  # (2,) as in Model
    fault: Array  # (2,) as in Model
    node: Array  # (N, 3) m, from here to `memory` views of the state
    node_velocity: Array  # (N, 3) m/s
    director: Array  # (N-1, 3)
    swirl: Array  # (N-1, 3) rad/s
    angle: Array  # (1,) rad
    rate: Array  # (1,) rad/s
    tension: Array  # (1,) N
    drive: Array  # (3,)
    bristle: Array  # (P, 3) m
    memory: Array  # (N-1 or 0, 4, 2)
    command: Array  # (1,) rad, commanded tendon angle
    stage: Array  # (N, 3) m, node at the stage
    velocity: Array  # (N, 3) m/s, V
    before: Array  # (N, 3) m/s, V_n in step axes
    base: Array  # (N, 3) m, stage position without the part due to V
    begin: Array  # (N-1, 3) directions of the segments at the step's start
    spin: Array  # (N-1,) rad/s, Omega
    spin_before: Array  # (N-1, 3) rad/s, S_n in step axes
    segments: Segments
    form: Array  # (7, 8) F
    moved: Array  # (6,) displacements of the clamp
    back: Array  # (N-1, 4, 8) rows for the substitution
    pull: Array  # (1,) N, tension at the iterate
    limit: Array  # (P or 0,) N, mu times the normal force of the contact points
    slope: Array  # (P or 0, 2) of the floor below
    release: Array  # (7,) lambda = release . (displacements of the clamp, 1)
    reduced: Array  # (6, 7) form over the displacements of the clamp
    product: Array  # (6, 6)
    frame: Array  # (3, 3) rows t, d, b of the clamp at the stage
    turns: Array  # (3, 3) rotation by -(1 - theta) h omega_n
    whole: Array  # (3, 3) scratch rotations
    back_turn: Array  # (3, 3)
    forth: Array  # (3, 3)
    motion: Array  # (3, 3) torso in leg axes: v, omega, theta h (omega - omega_n)
    axis_rate: Array  # (3,) rad/s, omega_n in leg axes
    field: Array  # (4, 3) odom's axes and gravity in leg axes


@helper
def predict(model, state, leg, h, theta):
    """The servo's rate, V_n in step axes, and the stage positions without the part due to V."""
    torque = model.tendon.spool_radius * leg.tension[0]
    leg.rate[0] = spool_rate(
        model.servo, leg.drive, leg.command[0], leg.angle[0], torque, h
    )
    w = state.rate
    wx, wy, wz = times(leg.axes, w[0], w[1], w[2])
    leg.axis_rate[0], leg.axis_rate[1], leg.axis_rate[2] = wx, wy, wz
    to_stage, to_end = leg.forth, leg.whole
    rotation(to_stage, -theta * h * wx, -theta * h * wy, -theta * h * wz)
    rotation(to_end, -h * wx, -h * wy, -h * wz)
    rest = (theta - 1.0) * h
    rotation(leg.turns, rest * wx, rest * wy, rest * wz)
    rx, ry, rz = leg.root[0], leg.root[1], leg.root[2]
    for i in range(leg.node.shape[0]):
        u, r = row(leg.node_velocity, i), row(leg.node, i)
        u = times(to_stage, u[0], u[1], u[2])
        put(leg.velocity, i, u)
        put(leg.before, i, u)
        x, y, z = times(to_end, rx + r[0], ry + r[1], rz + r[2])
        past = 1.0 - theta
        leg.base[i, 0] = past * r[0] + theta * (x - rx)
        leg.base[i, 1] = past * r[1] + theta * (y - ry)
        leg.base[i, 2] = past * r[2] + theta * (z - rz)
    point_along(leg.segments, leg.node)
    for k in range(leg.spin.shape[0]):
        t, s = row(leg.segments.direction, k), row(leg.swirl, k)
        put(leg.begin, k, t)
        leg.spin[k] = dot(t, s)
        put(leg.spin_before, k, times(to_stage, s[0], s[1], s[2]))
    remember(leg.segments, model.rod.relaxation, leg.memory, theta * h)


@helper
def stage(leg, tau):
    """Stage positions and frames of a leg, m, and the clamp's velocity from the torso's, m/s."""
    velocity, base, motion, q = leg.velocity, leg.base, leg.motion, leg.turns
    v, w, turn = row(motion, 0), row(motion, 1), row(motion, 2)
    root = (leg.root[0], leg.root[1], leg.root[2])
    put(leg.stage, 0, cross(turn, root))
    put(velocity, 0, plus(v, 1.0, cross(w, root)))
    for i in range(1, leg.stage.shape[0]):
        u = plus(row(velocity, i), -1.0, v)
        put(leg.stage, i, plus(row(base, i), tau, times(q, u[0], u[1], u[2])))
    point_along(leg.segments, leg.stage)
    rate = (leg.axis_rate[0], leg.axis_rate[1], leg.axis_rate[2])
    orient(leg.segments, leg.begin, leg.director, leg.spin, rate, tau)
    hold_clamp(leg)


@helper
def hold_clamp(leg):
    """Frame of the clamp at the stage: rows t outward, d to the right, b downward, turned."""
    turn, f, r = row(leg.motion, 2), leg.frame, leg.whole
    rotation(r, turn[0], turn[1], turn[2])
    for c in range(3):
        f[0, c], f[1, c], f[2, c] = r[c, 0], -r[c, 1], -r[c, 2]


@helper
def load_leg(model, leg, tau):
    """Strains and tendon tension of a leg at the iterate."""
    s, f, rate = leg.segments, leg.frame, leg.rate[0]
    clamp = (row(f, 0), row(f, 1), row(f, 2))
    measure(s, model.rod, leg.velocity, leg.spin, clamp, row(leg.motion, 1))
    leg.pull[0] = pull(s, model.tendon, leg.angle[0] + tau * rate, rate, leg.fault)


@helper
def advance_bristles(floor, leg, h):
    """Integrate the bristles of a leg's contact points over the step."""
    f = leg.field
    for p in range(4 * (floor.first - 1), leg.bristle.shape[0]):
        k, reach = p // 4, floor.half_width
        if p % 2 == 0:
            reach = -reach
        d = row(leg.segments.director, k)
        a = (reach * d[0], reach * d[1], reach * d[2])
        u = plus(
            row(leg.velocity, k + (p // 2) % 2), 1.0, cross(angular_velocity(leg, k), a)
        )
        x, y, z = times(f, u[0], u[1], u[2])
        bristle = leg.bristle[p]
        advance_bristle(
            floor, bristle, leg.limit[p], floor.stiffness[p], leg.slope[p], h, x, y, z
        )


@helper
def finish(model, state, work, leg, h, theta):
    """Nodes in leg axes, frames, tension and tendon angle at the end of the step."""
    relax(leg.segments, model.rod, leg.memory, h, theta)
    v, w, w0 = work.motion[0], work.motion[1], state.rate
    w = times(leg.axes, w[0], w[1], w[2])
    ox, oy, oz = times(leg.axes, w0[0], w0[1], w0[2])
    v = times(leg.axes, v[0], v[1], v[2])
    whole, back, rest, past = leg.whole, leg.back_turn, leg.forth, 1.0 / theta
    rotation(whole, -h * w[0], -h * w[1], -h * w[2])
    rotation(back, theta * h * ox, theta * h * oy, theta * h * oz)
    product(rest, whole, back)
    rx, ry, rz = leg.root[0], leg.root[1], leg.root[2]
    for i in range(leg.node.shape[0]):
        u, p, r = row(leg.velocity, i), row(leg.before, i), row(leg.node, i)
        if i > 0:
            x, y, z = times(whole, rx + r[0], ry + r[1], rz + r[2])
            d = times(rest, u[0] - v[0], u[1] - v[1], u[2] - v[2])
            put(leg.node, i, (x + h * d[0] - rx, y + h * d[1] - ry, z + h * d[2] - rz))
        e = plus(p, past, plus(u, -1.0, p))
        put(leg.node_velocity, i, times(rest, e[0], e[1], e[2]))
    for k in range(leg.spin.shape[0]):
        t, p, own = row(leg.segments.direction, k), row(leg.spin_before, k), leg.spin[k]
        e = plus(p, past, (own * t[0] - p[0], own * t[1] - p[1], own * t[2] - p[2]))
        put(leg.swirl, k, times(rest, e[0], e[1], e[2]))
    point_along(leg.segments, leg.node)
    orient(leg.segments, leg.begin, leg.director, leg.spin, w, h)
    for k in range(leg.spin.shape[0]):
        put(leg.director, k, row(leg.segments.director, k))
    leg.tension[0] = leg.pull[0]
    leg.angle[0] += h * leg.rate[0]
