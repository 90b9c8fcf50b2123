"""A spatial leg within a time step: prediction, stage, strains and tension, end of the step.

The unknowns of a step are the velocities of the nodes and the spins of the segments about
themselves. The spin's angular momentum is kept as a vector, I S with S = Omega t at the stage, so
that the angular momentum of a free rod is conserved to rounding by the midpoint rule.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from slot_core.arrays import Shapes, named
from slot_core.compiled import helper
from slot_core.dynamics.algebra import (
    add,
    cross,
    dot,
    minus,
    plus,
    product,
    put,
    rotation,
    row,
    scaled,
    store,
    times,
)
from slot_core.dynamics.contact import advance_bristle
from slot_core.dynamics.rod import pull
from slot_core.dynamics.servo import spool_rate
from slot_core.dynamics.spatial.elimination import angular_velocity
from slot_core.dynamics.spatial.strain import (
    frame_before,
    measure,
    orient,
    point_along,
    relax,
    remember,
)


def leg_shapes(nodes: int, points: int = 0) -> Shapes:
    """Parameters, state views and scratch arrays of one leg in leg axes; no step allocates memory.

    The arrays of four legs have one axis more, the last (`lanes.py`). `integrator.py` defines the
    "step axes".
    """
    n = nodes - 1
    return {
        "axes": (3, 3),  # base_link to leg axes
        "root": (3,),  # m, clamp from the torso's centre
        # torso increments to the displacements (X, Phi) of the clamp
        "clamp": (6, 6),
        "friction": (2,),  # as in Model
        "fault": (2,),  # as in Model
        "node": (nodes, 3),  # m, from here to `memory` views of the state
        "node_velocity": (nodes, 3),  # m/s
        "director": (n, 3),
        "swirl": (n, 3),  # rad/s
        "angle": (1,),  # rad
        "rate": (1,),  # rad/s
        "tension": (1,),  # N
        "drive": (3,),
        "bristle": (points, 3),  # m
        "memory": (0, 4, 2),  # (N-1, 4, 2) of a material that relaxes
        "command": (1,),  # rad, commanded tendon angle
        "stage": (nodes, 3),  # m, node at the stage
        "velocity": (nodes, 3),  # m/s, V
        "before": (nodes, 3),  # m/s, V_n in step axes
        "base": (nodes, 3),  # m, stage position without the part due to V
        "begin": (n, 3),  # directions of the segments at the step's start
        "spin": (n,),  # rad/s, Omega
        "spin_before": (n, 3),  # rad/s, S_n in step axes
        "form": (7, 8),  # F
        "moved": (6,),  # displacements of the clamp
        "back": (n, 4, 8),  # rows for the substitution
        "pull": (1,),  # N, tension at the iterate
        # N, mu times the normal force of the contact points
        "limit": (points,),
        "slope": (points, 2),  # of the floor below
        "release": (7,),  # lambda = release . (displacements of the clamp, 1)
        "reduced": (6, 7),  # form over the displacements of the clamp
        "product": (6, 6),
        "frame": (3, 3),  # rows t, d, b of the clamp at the stage
        "turns": (3, 3),  # rotation by -(1 - theta) h omega_n
        "whole": (3, 3),  # scratch rotations
        "back_turn": (3, 3),
        "forth": (3, 3),
        # torso in leg axes: v, omega, theta h (omega - omega_n)
        "motion": (3, 3),
        "axis_rate": (3,),  # rad/s, omega_n in leg axes
        "field": (4, 3),  # odom's axes and gravity in leg axes
    }


SpatialLeg = named("SpatialLeg", [*leg_shapes(1), "segments"], __name__)


@helper
def predict(model, state, leg, h, theta):
    """The servo's rate, V_n in step axes, and the stage positions without the part due to V."""
    torque = model.tendon.spool_radius * leg.tension[0]
    leg.rate[0] = spool_rate(
        model.servo, leg.drive, leg.command[0], leg.angle[0], torque, h
    )
    w = times(leg.axes, state.rate)
    store(leg.axis_rate, w)
    to_stage, to_end = leg.forth, leg.whole
    past = 1.0 - theta
    rotation(to_stage, scaled(-theta * h, w))
    rotation(to_end, scaled(-h, w))
    rotation(leg.turns, scaled((theta - 1.0) * h, w))
    root = (leg.root[0], leg.root[1], leg.root[2])
    for i in range(leg.node.shape[0]):
        u = times(to_stage, row(leg.node_velocity, i))
        put(leg.velocity, i, u)
        put(leg.before, i, u)
        r = row(leg.node, i)
        turned = minus(times(to_end, add(root, r)), root)
        put(leg.base, i, plus(scaled(past, r), theta, turned))
    point_along(leg.segments, leg.node)
    for k in range(leg.spin.shape[0]):
        t, s = row(leg.segments.direction, k), row(leg.swirl, k)
        put(leg.begin, k, t)
        leg.spin[k] = dot(t, s)
        put(leg.spin_before, k, times(to_stage, s))
    remember(leg.segments, model.rod.relaxation, leg.memory, theta * h)


@helper
def stage(leg, tau):
    """Stage positions and frames of a leg, m, and the clamp's velocity from the torso's, m/s."""
    velocity, base = leg.velocity, leg.base
    v, w, turn = row(leg.motion, 0), row(leg.motion, 1), row(leg.motion, 2)
    root = (leg.root[0], leg.root[1], leg.root[2])
    put(leg.stage, 0, cross(turn, root))
    put(velocity, 0, add(v, cross(w, root)))
    for i in range(1, leg.stage.shape[0]):
        u = times(leg.turns, minus(row(velocity, i), v))
        put(leg.stage, i, plus(row(base, i), tau, u))
    point_along(leg.segments, leg.stage)
    rate = (leg.axis_rate[0], leg.axis_rate[1], leg.axis_rate[2])
    orient(leg.segments, leg.begin, leg.director, leg.spin, rate, tau)
    hold_clamp(leg)


@helper
def hold_clamp(leg):
    """Frame of the clamp at the stage: rows t outward, d to the right, b downward, turned."""
    f, r = leg.frame, leg.whole
    rotation(r, row(leg.motion, 2))
    for c in range(3):
        f[0, c] = r[c, 0]
        f[1, c] = -r[c, 1]
        f[2, c] = -r[c, 2]


@helper
def load_leg(model, leg, tau):
    """Strains and tendon tension of a leg at the iterate."""
    s, rate = leg.segments, leg.rate[0]
    clamp = frame_before(s, 0, leg.frame)
    measure(s, model.rod, leg.velocity, leg.spin, clamp, row(leg.motion, 1))
    leg.pull[0] = pull(
        s, model.tendon, leg.angle[0] + tau * rate, rate, leg.fault
    )


@helper
def advance_bristles(floor, leg, h):
    """Integrate the bristles of a leg's contact points over the step."""
    for p in range(4 * (floor.first - 1), leg.bristle.shape[0]):
        k = p // 4
        reach = floor.half_width if p % 2 else -floor.half_width
        arm = scaled(reach, row(leg.segments.director, k))
        u = row(leg.velocity, k + (p // 2) % 2)
        u = times(leg.field, add(u, cross(angular_velocity(leg, k), arm)))
        limit, stiffness = leg.limit[p], floor.stiffness[p]
        advance_bristle(
            floor, leg.bristle[p], limit, stiffness, leg.slope[p], h, u
        )


@helper
def finish(model, state, work, leg, h, theta):
    """Nodes in leg axes, frames, tension and tendon angle at the end of the step."""
    s, past = leg.segments, 1.0 / theta
    relax(s, model.rod, leg.memory, h, theta)
    v = times(leg.axes, work.motion[0])
    w = times(leg.axes, work.motion[1])
    w0 = times(leg.axes, state.rate)
    to_end, rest = leg.whole, leg.forth
    rotation(to_end, scaled(-h, w))
    rotation(leg.back_turn, scaled(theta * h, w0))
    product(rest, to_end, leg.back_turn)
    root = (leg.root[0], leg.root[1], leg.root[2])
    for i in range(leg.node.shape[0]):
        u, p = row(leg.velocity, i), row(leg.before, i)
        if i > 0:
            r = times(to_end, add(root, row(leg.node, i)))
            moved = plus(r, h, times(rest, minus(u, v)))
            put(leg.node, i, minus(moved, root))
        u = plus(p, past, minus(u, p))
        put(leg.node_velocity, i, times(rest, u))
    for k in range(leg.spin.shape[0]):
        p = row(leg.spin_before, k)
        gained = minus(scaled(leg.spin[k], row(s.direction, k)), p)
        put(leg.swirl, k, times(rest, plus(p, past, gained)))
    point_along(s, leg.node)
    orient(s, leg.begin, leg.director, leg.spin, w, h)
    for k in range(leg.spin.shape[0]):
        put(leg.director, k, row(s.director, k))
    leg.tension[0] = leg.pull[0]
    leg.angle[0] += h * leg.rate[0]
