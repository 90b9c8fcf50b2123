"""One time step of the torso on tabulated legs; the equations are in `tabulated_robot.py`."""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from typing import NamedTuple

from slot_core.arrays import Array
from slot_core.compiled import helper, kernel
from slot_core.dynamics.algebra import (
    add,
    cross,
    dot,
    minus,
    plus,
    plus_dot,
    put,
    row,
    scaled,
    solve,
    store,
    times,
)
from slot_core.dynamics.contact import (
    advance_bristle,
    coefficient,
    friction_force,
    tangential,
)
from slot_core.dynamics.handle import contents
from slot_core.dynamics.integrator import (
    bend_corners,
    finish_rate,
    finish_torso,
    predict_torso,
    start_torso,
)
from slot_core.dynamics.servo import spool_rate
from slot_core.dynamics.torso import add_row, at, subtract_force

TOO_FAST, TOO_TILTED = range(2)  # kinds of divergence
TILT_MAX_DEG, COS_TILT_MAX = 60.0, 0.5  # largest tilt of the torso
# least D, so that a foot that moves ahead of the torso cannot lock it
NORMAL_PER_DROP_MIN = 0.25
# Of friction, normal force and side rate of a foot, each of which needs the others. They begin
# where the step before ended: 3 leave 2 um in stand and step, 20 iterations as the reference.
ITERATIONS = 3


class MapLegs(NamedTuple):
    """Parameters of the four legs."""

    # (m, n, 6) over angle and height: force (N), x of the contact (m), tension (N), the outward
    # shift of the material on the floor per angle and per height (m/rad, m/m), and the stiffness
    # sideways (N/m)
    table: Array
    angle_step: float  # rad; the first angle is zero
    height_low: float  # m
    height_step: float  # m
    clamps: Array  # (4, 3) m, base_link
    outward: Array  # (4, 3) x axes of the legs, base_link
    left: Array  # (4, 3) y axes
    damping_time: float  # s


class Feet(NamedTuple):
    """Variables of the legs beside the mechanical state."""

    command: Array  # (4,) rad
    force: Array  # (4, 3) N, of the floor on the feet, odom, at the stage of the last step
    limit: Array  # (4,) N, mu times the normal force
    side_rate: Array  # (4,) m/s, of the feet out of the planes of their legs, at that stage
    flat: Array  # (2,) slopes of the floor, zero


class LegResponse(NamedTuple):
    """Interpolated row of the table; `_h` and `_a`: derivatives over height and angle."""

    force: float
    force_h: float
    force_a: float
    x: float
    x_h: float
    x_a: float
    tension: float
    tension_h: float
    tension_a: float
    sideways: float


class Foot(NamedTuple):
    """Contact point of a leg with the floor, in step axes."""

    place: tuple[float, float, float]  # m, r from the torso's centre
    up: tuple[float, float, float]  # n
    slope: float  # n.a
    normal_per_drop: float  # D
    # m = x_eta a - k: shift of the foot in the torso per drop
    path: tuple[float, float, float]
    lean: float  # n.b / D: drop per shift sideways
    # w = b + n.b / D m: shift of the foot per shift sideways
    across: tuple[float, float, float]


@kernel
def advance(machine, steps):
    """Advance by `steps` steps; returns (steps done, -1) or (steps done, kind of divergence).

    machine: handle of (model, legs, state, feet, work, scheme).
    """
    model, legs, state, feet, work, scheme = contents(machine)
    for k in range(steps):
        one_step(model, legs, state, feet, work, scheme)
        divergence = divergence_of(state, model.speed_limit)
        if divergence >= 0:
            return k + 1, divergence
    return steps, -1


@helper
def divergence_of(state, limit):
    """Kind of divergence of the torso, or -1; limit: m/s and rad/s."""
    if not dot(state.velocity, state.velocity) < limit * limit:
        return TOO_FAST
    if not dot(state.rate, state.rate) < limit * limit:
        return TOO_FAST
    return -1 if state.rotation[2, 2] > COS_TILT_MAX else TOO_TILTED


@helper
def one_step(model, legs, state, feet, work, scheme):
    """One step in place: the theta scheme of `integrator.py` for the torso's velocities alone."""
    h, theta = scheme.step, scheme.theta
    tau, definite = theta * h, True
    floor = model.floor
    predict_torso(model, state, work, h, theta)
    for k in range(4):
        angle, command = state.tendon_angle[k], feet.command[k]
        torque = model.tendon.spool_radius * state.tension[k]
        rate = spool_rate(
            model.servo, state.drive[k], command, angle, torque, h
        )
        state.tendon_rate[k] = rate
    for _ in range(scheme.iterations):
        place = start_torso(model, state, work, tau)
        for k in range(4):
            _add_leg(model, legs, state, feet, work, k, place, tau)
        definite = definite & solve(work.matrix, work.vector)
        for i in range(3):
            work.motion[0, i] += work.vector[i] / tau
            work.motion[1, i] += work.vector[3 + i] / tau
    if floor.bristle > 0.0:
        bend_corners(model, state, work, h)
        for k in range(4):
            bristle, limit = state.bristle[k, 0], feet.limit[k]
            slip, stiffness = state.node_velocity[k, 0], floor.stiffness[-1]
            advance_bristle(
                floor, bristle, limit, stiffness, feet.flat, h, slip
            )
    finish_torso(state, work, h, theta)
    finish_rate(state, work, theta)
    for k in range(4):
        state.tendon_angle[k] += h * state.tendon_rate[k]
        state.node[k, 0, 1] += h * feet.side_rate[k]
    work.counter[1] += 0.0 if definite else 1.0


@helper
def _add_leg(model, legs, state, feet, work, k, place, tau):
    """Add leg k to the linear system of the torso; store its foot, tension and ground force."""
    axes, a, inv, beta = (
        work.rotation,
        legs.outward[k],
        1.0 / tau,
        legs.damping_time,
    )
    radius, rate = model.tendon.spool_radius, state.tendon_rate[k]
    angle = state.tendon_angle[k] + tau * rate - model.fault[0, k] / radius
    rate *= model.fault[1, k] * (angle > 0.0)
    angle = model.fault[1, k] * max(0.0, angle)
    here, foot = _contact_point(legs, state, feet, work, k, place, angle, tau)
    drop_rate, slip = _slip_and_drop_rate(work, a, here, foot, rate)
    force_slope = min(0.0, here.force_h)
    force_rate = force_slope * drop_rate + here.force_a * rate
    leg_force = max(0.0, here.force + beta * force_rate)
    leg_force *= here.force > 0.0
    spring = here.sideways * (tau + beta)
    load = leg_force * foot.lean - here.sideways * state.node[k, 0, 1]
    own, other = model.friction[0, k], model.friction[1, k]
    outward, released = dot(slip, a), state.tendon_rate[k]
    mu = coefficient(
        model.floor, own, other, released, outward, dot(slip, slip)
    )
    held = (leg_force, spring, load, slip)
    friction, normal, side, slip = _friction(
        model, state, feet, axes, k, mu, tau, held, foot
    )
    drop_rate += foot.lean * side
    f = minus(scaled(-friction.drag, slip), friction.held)
    stiffness = -force_slope * (1.0 + beta * inv) / foot.normal_per_drop**2
    stiffness *= leg_force > 0.0
    subtract_force(work.vector, foot.place, plus(f, normal, foot.up))
    _add_stiffness(
        work.matrix, foot, stiffness, friction.drag * inv, spring * inv
    )
    along = dot(f, a) + normal * foot.slope
    tension = here.tension - here.x_a * along / radius
    tension += beta * (here.tension_h * drop_rate + here.tension_a * rate)
    state.tension[k] = max(0.0, tension) * (here.tension > 0.0)
    feet.limit[k] = mu * normal
    feet.side_rate[k] = side
    store(state.node_velocity[k, 0], times(axes, slip))
    put(feet.force, k, times(axes, add(scaled(normal, foot.up), f)))


@helper
def _contact_point(legs, state, feet, work, k, place, angle, tau):
    """Interpolated table and contact point of leg k.

    The drop of the foot below the clamp follows from its place along the leg at the last iterate.
    """
    a, b, clamp = legs.outward[k], legs.left[k], legs.clamps[k]
    x, y = state.node[k, 0, 0], state.node[k, 0, 1] + tau * feet.side_rate[k]
    root = (clamp[0] + y * b[0], clamp[1] + y * b[1], clamp[2])
    up = row(work.rotation, 2)
    p = plus(root, x, a)
    drop = plus_dot(place[2], up, at(p, work.motion[2], p)) / up[2]
    here = _interpolate(legs, angle, drop)
    x = here.x
    state.node[k, 0, 0] = x
    state.node[k, 0, 2] = -drop
    slope = dot(up, a)
    per_drop = max(NORMAL_PER_DROP_MIN, up[2] - slope * here.x_h)
    path = (here.x_h * a[0], here.x_h * a[1], here.x_h * a[2] - 1.0)
    lean = (up[0] * b[0] + up[1] * b[1]) / per_drop
    foot = Foot(
        place=(
            root[0] + x * a[0],
            root[1] + x * a[1],
            root[2] + x * a[2] - drop,
        ),
        up=up,
        slope=slope,
        normal_per_drop=per_drop,
        path=path,
        lean=lean,
        across=(b[0] + lean * path[0], b[1] + lean * path[1], lean * path[2]),
    )
    return here, foot


@helper
def _slip_and_drop_rate(work, a, here, foot, rate):
    """Rate of the foot's drop below the clamp, m/s, and slip of the foot, step axes, m/s.

    Of a foot that does not move sideways in its leg.
    """
    up, shift_rate = foot.up, here.x_a * rate
    rigid = at(work.motion[0], work.motion[1], foot.place)
    drop_rate = (
        dot(up, rigid) + foot.slope * shift_rate
    ) / foot.normal_per_drop
    slip = plus(plus(rigid, drop_rate, foot.path), shift_rate, a)
    return drop_rate, plus(slip, -dot(up, slip), up)


@helper
def _interpolate(legs, angle, height):
    """Bilinear; force and tension are extrapolated beyond the heights, and at least zero."""
    table = legs.table
    place = angle / legs.angle_step
    i = _cell_at(place, table.shape[0])
    u = min(1.0, place - i)
    place = (height - legs.height_low) / legs.height_step
    j = _cell_at(place, table.shape[1])
    t = place - j
    inside = min(1.0, max(0.0, t))
    da, dh = 1.0 / legs.angle_step, 1.0 / legs.height_step
    force, force_h, force_a = _cell(table, i, j, 0, u, t, dh, da)
    tension, tension_h, tension_a = _cell(table, i, j, 2, u, t, dh, da)
    if force <= 0.0:
        force = force_h = force_a = 0.0
    return LegResponse(
        force=force,
        force_h=force_h,
        force_a=force_a,
        x=_cell(table, i, j, 1, u, inside, dh, da)[0],
        x_h=_cell(table, i, j, 4, u, inside, dh, da)[0],
        x_a=_cell(table, i, j, 3, u, inside, dh, da)[0],
        tension=max(0.0, tension),
        tension_h=tension_h,
        tension_a=tension_a,
        sideways=_cell(table, i, j, 5, u, inside, dh, da)[0],
    )


@helper
def _cell_at(place, count):
    """Cell of a place in a grid of `count` points; the first one for NaN, whose integer is none."""
    return int(min(place, count - 2.0)) if place > 0.0 else 0


@helper
def _cell(table, i, j, c, u, t, dh, da):
    """Bilinear value of column c in cell (i, j), and its derivatives over height and angle."""
    rise_low = table[i, j + 1, c] - table[i, j, c]
    rise_high = table[i + 1, j + 1, c] - table[i + 1, j, c]
    low = table[i, j, c] + t * rise_low
    high = table[i + 1, j, c] + t * rise_high
    rise = (1.0 - u) * rise_low
    rise += u * rise_high
    return low + u * (high - low), rise * dh, (high - low) * da


@helper
def _friction(model, state, feet, axes, k, mu, tau, held, foot):
    """Friction of foot k, its normal force (N), side rate and slip (m/s), by iteration.

    held: force of the leg (N), resistance of its foot to the side rate (N s/m), force on it
    sideways without friction (N), and slip without side rate (m/s).
    """
    floor, m, w = model.floor, foot.path, foot.across
    leg_force, spring, load, start = held
    stiffness, damping = floor.stiffness[-1], floor.damping[-1]
    bristle = start
    if floor.bristle > 0.0:
        bristle = tangential(axes, state.bristle[k, 0], foot.up)
    side, normal = feet.side_rate[k], leg_force / foot.normal_per_drop
    slip = plus(start, side, w)
    f = friction_force(
        floor, mu * normal, tau, stiffness, damping, bristle, slip
    )
    for _ in range(ITERATIONS):
        resistance = spring + f.drag * dot(w, w)
        side = (load - f.drag * dot(start, w) - dot(f.held, w)) / resistance
        slip = plus(start, side, w)
        pressed = max(0.0, leg_force - f.drag * dot(slip, m) - dot(f.held, m))
        normal = pressed / foot.normal_per_drop
        f = friction_force(
            floor, mu * normal, tau, stiffness, damping, bristle, slip
        )
    return f, normal, side, slip


@helper
def _add_stiffness(H, foot, stiffness, drag, spring):
    """H += stiffness n n^T + sum_ij s_i C_ij s_j^T with s_i = e_i + m_i n / D.

    n, e_i: rows (6,) of the motion of the foot along the normal and along axis i. The foot, with
    the resistance `spring` sideways, yields to the drag:
    C = drag (1 - drag w w^T / (spring + drag w.w)).
    """
    x, y, z = foot.place
    m, w, per = foot.path, foot.across, 1.0 / foot.normal_per_drop
    n = (*foot.up, *cross(foot.place, foot.up))
    s = (*w, *cross(foot.place, w))
    add_row(H, stiffness, n)
    add_row(H, drag, _add_rows((1.0, 0.0, 0.0, 0.0, z, -y), m[0] * per, n))
    add_row(H, drag, _add_rows((0.0, 1.0, 0.0, -z, 0.0, x), m[1] * per, n))
    add_row(H, drag, _add_rows((0.0, 0.0, 1.0, y, -x, 0.0), m[2] * per, n))
    yielding = -drag * drag / (spring + drag * dot(w, w))
    add_row(H, yielding, _add_rows(s, dot(w, m) * per, n))


@helper
def _add_rows(e, m, n):
    """e + m n, of six numbers each."""
    return (
        e[0] + m * n[0],
        e[1] + m * n[1],
        e[2] + m * n[2],
        e[3] + m * n[3],
        e[4] + m * n[4],
        e[5] + m * n[5],
    )
