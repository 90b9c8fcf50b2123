"""Time integration of the whole robot: four soft legs and the torso, solved together.

Theta scheme with the stage at t + theta h: with inv = 1 / (theta h),

    M (V - V_n) inv = F(x_n + theta h V, V),      V_{n+1} = V_n + (V - V_n) / theta,

solved for the stage velocity V by Newton's method with a fixed number of iterations.

The unknowns are absolute velocities: of the nodes and of the torso, and the spins of the segments.
The internal forces of a segment depend only on differences of its nodes and
frames. Torso and leg are therefore coupled at the clamp alone, where they exchange momentum, and
`eliminate` solves each leg on its own.

The step axes are fixed in odom at R_n exp(theta h omega_n). A stage position is the mean of the
positions at both ends of the step, each relative to the torso at that end, so that a steady spin
does not strain the legs to second order in h.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math

from slot_core.compiled import helper, kernel
from slot_core.dynamics.algebra import (
    dot,
    minus,
    orthonormalise,
    plus,
    product,
    put,
    rotation,
    row,
    scaled,
    solve,
    store,
    times,
    times_transposed,
)
from slot_core.dynamics.contact import advance_bristle
from slot_core.dynamics.handle import contents
from slot_core.dynamics.lanes import all_lanes, in_lanes
from slot_core.dynamics.spatial.elimination import (
    add_to_torso,
    couple,
    eliminate,
    substitute,
)
from slot_core.dynamics.spatial.leg import (
    advance_bristles,
    finish,
    load_leg,
    predict,
    stage,
)
from slot_core.dynamics.torso import (
    add_corners,
    add_inertia,
    add_payload,
    add_push,
    at,
)


@kernel
def advance(machine, steps):
    """Advance by `steps` steps; returns (steps done, -1) or, diverged, (steps done, `lost` code).

    machine: handle of (model, state, work, start, legs, scheme); the legs in lanes.

    A step is repeated from its `start` in 2, 4, ... 2^halvings pieces if it diverges (see `lost`),
    has a pivot that is not positive, or moves a node by more than the limit in its last Newton
    correction. A step that has used all halvings is counted; it ends the run only if it diverged.
    """
    model, state, work, start, legs, scheme = contents(machine)
    return advance_contents(
        model, state, work, start, (in_lanes(legs),), scheme, steps
    )


@helper
def advance_contents(model, state, work, start, legs, scheme, steps):
    """`advance` on the arrays of its handle; legs: a tuple of one in lanes, or of legs."""
    for k in range(steps):
        copy(start.buffer, state.buffer)
        for halving in range(scheme.halvings + 1):
            pieces = 1 << halving
            where, correction = -1, 0.0
            for _ in range(pieces):
                change = step(
                    model, state, work, legs, scheme.step / pieces, scheme
                )
                correction = max(correction, change)
                where = lost(state, legs, model.speed_limit)
                if where >= 0:
                    break
            if (
                where < 0
                and correction * (scheme.step / pieces)
                <= scheme.correction_limit
            ):
                break
            if halving < scheme.halvings:
                copy(state.buffer, start.buffer)
                work.counter[0] += 1.0
            else:
                work.counter[2] += 1.0
        if where >= 0:
            return k, where
    return steps, -1


@helper
def copy(out, source):
    """Copy an array; a slice assignment would compile the code of its error message too."""
    for i in range(source.size):
        out[i] = source[i]


@helper
def lost(state, legs, limit):
    """Divergence check: -1 if all is finite and slower than `limit`, m/s, rad/s; else a code.

    The code is 0 for the torso and 1 for a leg: a node, or a tendon angle that is not finite, which
    under a slack tendon no node would show.
    """
    if not dot(state.position, state.position) < math.inf:
        return 0
    if not dot(state.velocity, state.velocity) < limit * limit:
        return 0
    if not dot(state.rate, state.rate) < limit * limit:
        return 0
    fine = True
    for leg in legs:
        fine = fine & all_lanes(leg.angle[0] * leg.angle[0] < math.inf)
        for i in range(leg.node_velocity.shape[0]):
            u = row(leg.node_velocity, i)
            fine = fine & all_lanes(dot(u, u) < limit * limit)
    return -1 if fine else 1


@helper
def step(model, state, work, legs, h, scheme):
    """One step of h, in place; returns the largest change of a node in the last iteration, m/s.

    Returns infinity if a pivot was not positive.
    """
    theta = scheme.theta
    tau = theta * h
    inv = 1.0 / tau
    definite, change = True, 0.0
    predict_torso(model, state, work, h, theta)
    for leg in legs:
        predict(model, state, leg, h, theta)
    for _ in range(scheme.iterations):
        place = start_torso(model, state, work, tau)
        for leg in legs:
            _to_leg_axes(work, leg)
            stage(leg, tau)
            load_leg(model, leg, tau)
            definite = definite & all_lanes(eliminate(model, leg, inv, place))
            couple(model.tendon, leg, inv)
            add_to_torso(leg, work.matrix, work.vector)
        definite = definite & solve(work.matrix, work.vector)
        change = 0.0
        for leg in legs:
            change = max(change, substitute(leg, work.vector, inv))
        for i in range(3):
            work.motion[0, i] += work.vector[i] * inv
            work.motion[1, i] += work.vector[3 + i] * inv
    if model.floor.bristle > 0.0:
        bend_corners(model, state, work, h)
        for leg in legs:
            advance_bristles(model.floor, leg, h)
    finish_torso(state, work, h, theta)
    for leg in legs:
        finish(model, state, work, leg, h, theta)
    finish_rate(state, work, theta)
    work.counter[1] += 0.0 if definite else 1.0
    return math.sqrt(change) if definite else math.inf


@helper
def predict_torso(model, state, work, h, theta):
    """Set the step axes and the torso's first iterate V = V_n."""
    motion, field, axes = work.motion, work.field, work.rotation
    rotation(work.turn, scaled(theta * h, state.rate))
    product(axes, state.rotation, work.turn)
    v = times_transposed(axes, state.velocity)
    put(motion, 0, v)
    put(motion, 1, state.rate)
    put(motion, 3, v)
    put(motion, 4, state.rate)
    for k in range(3):
        put(field, k, row(axes, k))
    put(field, 3, times_transposed(axes, model.gravity))


@helper
def start_torso(model, state, work, tau):
    """Assemble the torso's system without the legs; returns its position at the stage, odom, m."""
    motion, axes, gravity = work.motion, work.rotation, row(work.field, 3)
    v, w, v0, w0 = (
        row(motion, 0),
        row(motion, 1),
        row(motion, 3),
        row(motion, 4),
    )
    place = plus(state.position, tau, times(axes, v))
    put(motion, 2, scaled(tau, minus(w, w0)))
    work.matrix[:] = 0.0
    work.vector[:] = 0.0
    H, g, inv = work.matrix, work.vector, 1.0 / tau
    add_inertia(H, g, model.torso, inv, gravity, v, v0, w, w0)
    if model.payload[0] > 0.0:
        add_payload(H, g, model.payload, inv, gravity, v, v0, w, w0)
    add_push(g, model.push, axes)
    held = (state.corner_bristle, work.limit, work.slope)
    turn = row(motion, 2)
    add_corners(
        H, g, model.torso, model.floor, inv, place, axes, v, w, turn, held
    )
    return place


@helper
def _to_leg_axes(work, leg):
    """Torso's motion, odom's axes and gravity in the axes of a leg."""
    for k in range(3):
        put(leg.motion, k, times(leg.axes, row(work.motion, k)))
    for k in range(4):
        put(leg.field, k, times(leg.axes, row(work.field, k)))


@helper
def bend_corners(model, state, work, h):
    """Integrate the bristles of the torso's corners over the step."""
    floor, corners = model.floor, model.torso.corners
    v, w = row(work.motion, 0), row(work.motion, 1)
    for k in range(corners.shape[0]):
        u = times(work.rotation, at(v, w, row(corners, k)))
        limit, slope = work.limit[k], work.slope[k]
        bristle, stiffness = state.corner_bristle[k], floor.corner_stiffness
        advance_bristle(floor, bristle, limit, stiffness, slope, h, u)


@helper
def finish_torso(state, work, h, theta):
    """The torso at the end of the step, except its rate: the legs still need the old one."""
    axes, motion, tau = work.rotation, work.motion, theta * h
    v, v0 = motion[0], motion[3]
    for i in range(3):
        state.specific_force[i] = (v[i] - v0[i]) / tau - work.field[3, i]
        motion[2, i] = v0[i] + (v[i] - v0[i]) / theta
    store(state.position, plus(state.position, h, times(axes, v)))
    store(state.velocity, times(axes, motion[2]))
    rotation(work.turn, scaled(h, motion[1]))
    product(work.next, state.rotation, work.turn)
    orthonormalise(state.rotation, work.next)


@helper
def finish_rate(state, work, theta):
    """The torso's rate at the end of the step."""
    w, w0 = work.motion[1], work.motion[4]
    for i in range(3):
        state.rate[i] = w0[i] + (w[i] - w0[i]) / theta
