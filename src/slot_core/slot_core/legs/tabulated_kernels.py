"""One time step of the torso on tabulated legs; the equations are in `tabulated_robot.py`."""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math
from typing import NamedTuple

from numba.extending import overload

from slot_core.arrays import Array, Shapes, named
from slot_core.compiled import OPTIONS, helper, kernel
from slot_core.dynamics.algebra import (
    combined,
    cross,
    dot,
    plus,
    plus_dot,
    put,
    row,
    scaled,
    solve,
    times,
    times_transposed,
)
from slot_core.dynamics.contact import (
    advance_bristle,
    coefficient,
    friction_force,
)
from slot_core.dynamics.handle import contents
from slot_core.dynamics.integrator import (
    bend_corners,
    finish_rate,
    finish_torso,
    predict_torso,
    start_torso,
)
from slot_core.dynamics.lanes import (
    LANES,
    in_lanes,
    in_turn,
    join,
    lane,
    like,
    where,
)
from slot_core.dynamics.servo import spool_rate
from slot_core.dynamics.torso import at

TOO_FAST, TOO_TILTED = range(2)  # kinds of divergence
TILT_MAX_DEG, COS_TILT_MAX = 60.0, 0.5  # largest tilt of the torso
# least D, so that a foot that moves ahead of the torso cannot lock it
NORMAL_PER_DROP_MIN = 0.25
# Of rates, friction and normal force of a foot, each of which needs the others. They begin where
# the step before ended: 3 leave 2 um in stand and step, 20 iterations as the reference.
ITERATIONS = 3
PLACE, YIELD = range(2)  # rows of a leg in the state's `node`


class MapLegs(NamedTuple):
    """Parameters of the four legs."""

    # (m, n, 9) over angle and height: force (N), x of the contact (m), tension (N), the outward
    # shift of the material on the floor per angle and per height (m/rad, m/m), and the stiffness
    # over the foot's displacements, S_xx, S_yy (N/m), S_yp (N) and S_pp (N m/rad)
    table: Array
    angle_step: float  # rad; the first angle is zero
    height_low: float  # m
    height_step: float  # m
    clamps: Array  # (4, 3) m, base_link
    outward: Array  # (4, 3) x axes of the legs, base_link
    left: Array  # (4, 3) y axes
    half_width: float  # m, of a foot
    damping_time: float  # s


# Variables of the legs beside the mechanical state; the legs are the last axis in memory.
FEET: Shapes = {
    "command": (4,),  # rad
    # N, of the floor on the feet, odom, at the stage of the last step
    "force": (3, 4),
    "limit": (4,),  # N, mu times the normal force of an edge
    # m/s, of the left and the right edge, odom; of bristle friction alone
    "slip": (2, 3, 4),
    "flat": (2,),  # slopes of the floor, zero
}
Feet = named("Feet", FEET, __name__)
# Constants of the legs, one row for each: those of MapLegs, and of the model.
Mounts = named(
    "Mounts", ["clamp", "outward", "left", "friction", "fault"], __name__
)
# Variables of the legs in state and feet, one row for each.
Sides = named(
    "Sides",
    [
        "tendon_angle",
        "tendon_rate",
        "tension",
        "drive",
        "node",
        "node_velocity",
        "bristle",
        "command",
        "force",
        "limit",
        "slip",
    ],
    __name__,
)


# Interpolated row of the table; `_h` and `_a`: derivatives over height and angle.
LegResponse = named(
    "LegResponse",
    [
        "force",
        "force_h",
        "force_a",
        "x",
        "x_h",
        "x_a",
        "tension",
        "tension_h",
        "tension_a",
        "spring",  # S_xx, S_yy, S_yp, S_pp
    ],
    __name__,
)
# Contact of a leg with the floor, in step axes.
Foot = named(
    "Foot",
    [
        "place",  # m, r from the torso's centre
        "up",  # n
        "slope",  # n.a
        "normal_per_drop",  # D
        # m = x_eta a - k: shift of the foot in the torso per drop
        "path",
        "along",  # e_1, unit vectors in the floor
        "aside",  # e_2
        "lever",  # m, l: of the edges about r
        # drop per displacement along the leg and sideways, n.a / D and n.b / D
        "lean",
        # shift on the floor, over e_1 and e_2, per displacement along the leg and sideways
        "drive",
    ],
    __name__,
)
# Friction of a foot over its slip z, the force -(M z + held), and what its leg yields; M is D_+ on
# the diagonal, and D_- between the first and the third number.
Grip = named(
    "Grip",
    [
        "rate",  # of the displacements
        "force",  # N, f.e_1, f.e_2, moment about n over l
        "slip",  # m/s
        "normal",  # N
        "drag",  # D_+, N s/m
        "uneven",  # D_-
        # A^-1, m/(N s), by rows of the upper triangle
        "yielding",
    ],
    __name__,
)


@kernel
def advance(machine, steps):
    """Advance by `steps` steps; returns (steps done, -1) or (steps done, kind of divergence).

    machine: handle of (model, legs, state, feet, work, scheme, sides).
    """
    model, legs, state, feet, work, scheme, sides = contents(machine)
    for k in range(steps):
        one_step(model, legs, state, feet, work, scheme, in_lanes(sides))
        divergence = divergence_of(state, model.speed_limit)
        if divergence >= 0:
            return k + 1, divergence
    return steps, -1


@helper
def is_slow(state, limit):
    """Whether the torso's speeds are below the limit, m/s and rad/s; a mask for Lanes."""
    return (dot(state.velocity, state.velocity) < limit * limit) & (
        dot(state.rate, state.rate) < limit * limit
    )


@helper
def divergence_of(state, limit):
    """Kind of divergence of the torso, or -1; limit: m/s and rad/s."""
    if not is_slow(state, limit):
        return TOO_FAST
    return -1 if state.rotation[2, 2] > COS_TILT_MAX else TOO_TILTED


@helper
def one_step(model, legs, state, feet, work, scheme, sides):
    """One step in place: the theta scheme of `integrator.py` for the torso's velocities alone.

    sides: Mounts and Sides. Those of one robot are in lanes, its four legs, and have one row; of
    four robots in lanes the Sides are so too, and have four rows.
    """
    h, theta = scheme.step, scheme.theta
    tau, definite = theta * h, True
    floor, leg, count = model.floor, sides[1], len(sides[1].tension)
    predict_torso(model, state, work, h, theta)
    for k in range(count):
        leg.tendon_rate[k] = spool_rate(
            model.servo,
            leg.drive[k],
            leg.command[k],
            leg.tendon_angle[k],
            model.tendon.spool_radius * leg.tension[k],
            h,
        )
    for _ in range(scheme.iterations):
        place = start_torso(model, state, work, tau)
        for k in range(count):
            _add_leg(model, legs, sides, work, k, place, tau)
        definite = definite & solve(work.matrix, work.vector)
        for i in range(3):
            work.motion[0, i] += work.vector[i] / tau
            work.motion[1, i] += work.vector[3 + i] / tau
    if floor.bristle > 0.0:
        bend_corners(model, state, work, h)
        for k in range(count):
            for side in range(2):
                advance_bristle(
                    floor,
                    leg.bristle[k, side],
                    leg.limit[k],
                    floor.stiffness[-1],
                    feet.flat,
                    h,
                    leg.slip[k, side],
                )
    finish_torso(state, work, h, theta)
    finish_rate(state, work, theta)
    for k in range(count):
        leg.tendon_angle[k] += h * leg.tendon_rate[k]
        for i in range(3):
            leg.node[k, YIELD, i] += h * leg.node_velocity[k, YIELD, i]
    work.counter[1] += 0.0 if definite else 1.0


@helper
def _add_leg(model, legs, sides, work, k, place, tau):
    """Add leg k to the linear system of the torso; store its foot, tension and ground force."""
    fixed, leg = sides
    axes, a, inv, beta = (
        work.rotation,
        fixed.outward[k],
        1.0 / tau,
        legs.damping_time,
    )
    radius, rate = model.tendon.spool_radius, leg.tendon_rate[k]
    angle = leg.tendon_angle[k] + tau * rate - fixed.fault[k, 0] / radius
    none = like(0.0, angle)
    rate *= where(angle > 0.0, like(fixed.fault[k, 1], angle), none)
    angle = fixed.fault[k, 1] * max(0.0, angle)
    here, foot = _contact_point(legs, sides, work, k, place, angle, tau)
    # rate of the drop, and slip, of a foot without displacements against its leg's equilibrium
    shift_rate = here.x_a * rate
    rigid = at(work.motion[0], work.motion[1], foot.place)
    drop_rate = (
        dot(foot.up, rigid) + foot.slope * shift_rate
    ) / foot.normal_per_drop
    slip = plus(plus(rigid, drop_rate, foot.path), shift_rate, a)
    slip = plus(slip, -dot(foot.up, slip), foot.up)
    force_slope = min(0.0, here.force_h)
    force_rate = force_slope * drop_rate + here.force_a * rate
    leg_force = max(0.0, here.force + beta * force_rate)
    leg_force = where(here.force > 0.0, leg_force, none)
    mu = coefficient(
        model.floor,
        like(fixed.friction[k, 0], angle),
        like(fixed.friction[k, 1], angle),
        leg.tendon_rate[k],
        dot(slip, a),
        dot(slip, slip),
    )
    grip = _grip(
        model,
        leg,
        axes,
        k,
        mu,
        (tau, tau + beta),
        leg_force,
        here.spring,
        slip,
        dot(foot.up, row(work.motion, 1)),
        foot,
    )
    normal, rate_of = grip.normal, grip.rate
    drop_rate += foot.lean[0] * rate_of[0] + foot.lean[1] * rate_of[1]
    f = combined(
        grip.force[0], foot.along, grip.force[1], foot.aside, normal, foot.up
    )
    stiffness = (
        -force_slope
        * (1.0 + beta * inv)
        / (foot.normal_per_drop * foot.normal_per_drop)
    )
    stiffness = where(leg_force > 0.0, stiffness, none)
    g, moment = work.vector, cross(foot.place, f)
    turning = foot.lever * grip.force[2]
    for i in range(3):
        g[i] = in_turn(g[i], (-f[i],))
        g[3 + i] = in_turn(g[3 + i], (-moment[i], -(turning * foot.up[i])))
    _add_stiffness(work.matrix, foot, stiffness, grip, inv)
    tension = (
        here.tension
        - here.x_a * dot(f, a) / radius
        + beta * (here.tension_h * drop_rate + here.tension_a * rate)
    )
    leg.tension[k] = where(here.tension > 0.0, max(0.0, tension), none)
    put(leg.node_velocity[k], YIELD, rate_of)
    put(leg.force, k, times(axes, f))
    if model.floor.bristle > 0.0:
        leg.limit[k] = 0.5 * mu * normal
        for side in range(2):
            along = grip.slip[0] + (2 * side - 1) * grip.slip[2]
            slip = plus(scaled(along, foot.along), grip.slip[1], foot.aside)
            put(leg.slip[k], side, times(axes, slip))


@helper
def _contact_point(legs, sides, work, k, place, angle, tau):
    """Interpolated table and contact point of leg k.

    The drop of the foot below the clamp follows from its place along the leg at the last iterate.
    """
    a, b, clamp = sides[0].outward[k], sides[0].left[k], sides[0].clamp[k]
    node, moved = sides[1].node[k], sides[1].node_velocity[k, YIELD]
    y = node[YIELD, 1] + tau * moved[1]
    root = (clamp[0] + y * b[0], clamp[1] + y * b[1], clamp[2])
    up = scaled(like(1.0, y), row(work.rotation, 2))
    p = plus(root, node[PLACE, 0], a)
    drop = plus_dot(place[2], up, at(p, work.motion[2], p)) / up[2]
    here = interpolate(legs, angle, drop)
    x = here.x + node[YIELD, 0] + tau * moved[0]
    put(node, PLACE, (x, y, -drop))
    slope, tilt = dot(up, a), up[0] * b[0] + up[1] * b[1]
    per_drop = max(NORMAL_PER_DROP_MIN, up[2] - slope * here.x_h)
    path = (here.x_h * a[0], here.x_h * a[1], here.x_h * a[2] - 1.0)
    lean = (slope / per_drop, tilt / per_drop)
    along = cross(b, up)
    width = math.sqrt(dot(along, along))
    along = scaled(1.0 / width, along)
    aside = cross(up, along)
    outward, left = plus(a, lean[0], path), plus(b, lean[1], path)
    return here, Foot(
        place=(
            root[0] + x * a[0],
            root[1] + x * a[1],
            root[2] + x * a[2] - drop,
        ),
        up=up,
        slope=slope,
        normal_per_drop=per_drop,
        path=path,
        along=along,
        aside=aside,
        lever=legs.half_width * width,
        lean=lean,
        drive=(
            dot(outward, along),
            dot(outward, aside),
            dot(left, along),
            dot(left, aside),
        ),
    )


def interpolate(legs, angle, height):
    """Response of a leg at numbers or Lanes; can be called in kernels only."""
    raise NotImplementedError("only in kernels")


@overload(interpolate, jit_options=OPTIONS)  # type: ignore[arg-type]
def _overload_interpolate(legs, angle, height):
    if angle != LANES:
        return _interpolate_one.py_func

    def each(legs, angle, height):
        a, b, c, d = (
            _interpolate_one(legs, lane(angle, 0), lane(height, 0)),
            _interpolate_one(legs, lane(angle, 1), lane(height, 1)),
            _interpolate_one(legs, lane(angle, 2), lane(height, 2)),
            _interpolate_one(legs, lane(angle, 3), lane(height, 3)),
        )
        return LegResponse(
            force=join(a.force, b.force, c.force, d.force),
            force_h=join(a.force_h, b.force_h, c.force_h, d.force_h),
            force_a=join(a.force_a, b.force_a, c.force_a, d.force_a),
            x=join(a.x, b.x, c.x, d.x),
            x_h=join(a.x_h, b.x_h, c.x_h, d.x_h),
            x_a=join(a.x_a, b.x_a, c.x_a, d.x_a),
            tension=join(a.tension, b.tension, c.tension, d.tension),
            tension_h=join(a.tension_h, b.tension_h, c.tension_h, d.tension_h),
            tension_a=join(a.tension_a, b.tension_a, c.tension_a, d.tension_a),
            spring=(
                join(a.spring[0], b.spring[0], c.spring[0], d.spring[0]),
                join(a.spring[1], b.spring[1], c.spring[1], d.spring[1]),
                join(a.spring[2], b.spring[2], c.spring[2], d.spring[2]),
                join(a.spring[3], b.spring[3], c.spring[3], d.spring[3]),
            ),
        )

    return each


@helper
def _interpolate_one(legs, angle, height):
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
        spring=(
            _cell(table, i, j, 5, u, inside, dh, da)[0],
            _cell(table, i, j, 6, u, inside, dh, da)[0],
            _cell(table, i, j, 7, u, inside, dh, da)[0],
            _cell(table, i, j, 8, u, inside, dh, da)[0],
        ),
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
def _grip(
    model, leg, axes, k, mu, stage, leg_force, spring, slip, turn_rate, foot
):
    """Friction of foot k, its normal force, and the rates of its displacements, by iteration.

    stage: theta h, and that plus beta (s); leg_force: F + beta dF/dt (N); slip: s (m/s); turn_rate:
    of the torso about the normal (rad/s).
    """
    floor, half = model.floor, 0.5 * mu
    stiffness, damping = floor.stiffness[-1], floor.damping[-1]
    none = like(0.0, leg_force)
    bent_left = bent_right = (none, none, none)
    if floor.bristle > 0.0:
        bent_left = _in_floor(axes, leg.bristle[k, 0], foot)
        bent_right = _in_floor(axes, leg.bristle[k, 1], foot)
    (sxx, syy, syp, spp), (x, y, turn) = spring, row(leg.node[k], YIELD)
    a1, a2, b1, b2 = foot.drive
    m1, m2 = dot(foot.path, foot.along), dot(foot.path, foot.aside)
    lever, per, (tau, held) = foot.lever, 1.0 / foot.normal_per_drop, stage
    start = (
        dot(slip, foot.along),
        dot(slip, foot.aside),
        lever * turn_rate,
    )
    rate, normal = row(leg.node_velocity[k], YIELD), per * leg_force
    z = _slip(start, foot.drive, lever, rate)
    force, drag, uneven = (none, none, none), none, none
    inverse = (none, none, none, none, none, none)
    for _ in range(ITERATIONS):
        limit = half * normal
        v = (z[0] - z[2], z[1], none)
        left = friction_force(
            floor, limit, tau, stiffness, damping, bent_left, v
        )
        v = (z[0] + z[2], z[1], none)
        right = friction_force(
            floor, limit, tau, stiffness, damping, bent_right, v
        )
        drag, uneven = left.drag + right.drag, right.drag - left.drag
        held_1 = left.held[0] + right.held[0]
        held_2 = left.held[1] + right.held[1]
        held_3 = right.held[0] - left.held[0]
        # M s + held
        g1 = drag * start[0] + uneven * start[2] + held_1
        g2 = drag * start[1] + held_2
        g3 = uneven * start[0] + drag * start[2] + held_3
        inverse = _inverse(
            sxx * held + drag * (a1 * a1 + a2 * a2),
            drag * (a1 * b1 + a2 * b2),
            uneven * a1 * lever,
            syy * held + drag * (b1 * b1 + b2 * b2),
            syp * held + uneven * b1 * lever,
            spp * held + drag * lever * lever,
        )
        rate = _image(
            inverse,
            (
                leg_force * foot.lean[0] - sxx * x - a1 * g1 - a2 * g2,
                leg_force * foot.lean[1]
                - syy * y
                - syp * turn
                - b1 * g1
                - b2 * g2,
                -syp * y - spp * turn - lever * g3,
            ),
        )
        z = _slip(start, foot.drive, lever, rate)
        force = (
            -drag * z[0] - uneven * z[2] - held_1,
            -drag * z[1] - held_2,
            -uneven * z[0] - drag * z[2] - held_3,
        )
        normal = per * max(0.0, leg_force + force[0] * m1 + force[1] * m2)
    return Grip(rate, force, z, normal, drag, uneven, inverse)


@helper
def _in_floor(axes, bristle, foot):
    """A bristle (3,), odom, over the unit vectors e_1 and e_2 in the floor, and zero."""
    v = times_transposed(axes, bristle)
    return dot(v, foot.along), dot(v, foot.aside), like(0.0, v[0])


@helper
def _slip(start, drive, lever, rate):
    """Slip z = s + W u of a foot over e_1 and e_2, and of its edges by the turn, m/s."""
    a1, a2, b1, b2 = drive
    return (
        start[0] + a1 * rate[0] + b1 * rate[1],
        start[1] + a2 * rate[0] + b2 * rate[1],
        start[2] + lever * rate[2],
    )


@helper
def _inverse(xx, xy, xz, yy, yz, zz):
    """Upper triangle, by rows, of the inverse of a symmetric matrix (3, 3) given so."""
    cxx, cxy, cxz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    per = 1.0 / (xx * cxx + xy * cxy + xz * cxz)
    cyy, cyz, czz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    return per * cxx, per * cxy, per * cxz, per * cyy, per * cyz, per * czz


@helper
def _image(m, v):
    """m v of a symmetric matrix (3, 3), given by the rows of its upper triangle."""
    return (
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[1] * v[0] + m[3] * v[1] + m[4] * v[2],
        m[2] * v[0] + m[4] * v[1] + m[5] * v[2],
    )


@helper
def _add_stiffness(H, foot, stiffness, grip, inv):
    """H += stiffness n n^T + sum_ij R_i C_ij R_j^T / (theta h), C = M - M W A^-1 W^T M.

    n: row (6,) of the torso's motion that moves the foot's place along the normal; R_i: rows of
    the slip, with the shift along e_i and that by the drop, and of the turn about the normal.
    """
    m, per, up, lever = (
        foot.path,
        1.0 / foot.normal_per_drop,
        foot.up,
        foot.lever,
    )
    n = (*up, *cross(foot.place, up))
    e_1 = (*foot.along, *cross(foot.place, foot.along))
    e_2 = (*foot.aside, *cross(foot.place, foot.aside))
    r_1 = _add_rows(e_1, dot(m, foot.along) * per, n)
    r_2 = _add_rows(e_2, dot(m, foot.aside) * per, n)
    none = like(0.0, lever)
    r_3 = (none, none, none, *scaled(lever, up))
    # rows of M W
    (a1, a2, b1, b2), drag, uneven = (
        foot.drive,
        inv * grip.drag,
        inv * grip.uneven,
    )
    v_1 = (grip.drag * a1, grip.drag * b1, grip.uneven * lever)
    v_2 = (grip.drag * a2, grip.drag * b2, none)
    v_3 = (grip.uneven * a1, grip.uneven * b1, grip.drag * lever)
    back = scaled(inv, _image(grip.yielding, v_1))
    c_11, c_12, c_13 = (
        drag - dot(back, v_1),
        -dot(back, v_2),
        uneven - dot(back, v_3),
    )
    back = scaled(inv, _image(grip.yielding, v_2))
    c_22, c_23 = drag - dot(back, v_2), -dot(back, v_3)
    c_33 = drag - inv * dot(_image(grip.yielding, v_3), v_3)
    for i in range(6):
        f_1 = c_11 * r_1[i] + c_12 * r_2[i] + c_13 * r_3[i]
        f_2 = c_12 * r_1[i] + c_22 * r_2[i] + c_23 * r_3[i]
        f_3 = c_13 * r_1[i] + c_23 * r_2[i] + c_33 * r_3[i]
        f_n = stiffness * n[i]
        for j in range(6):
            H[i, j] = in_turn(
                H[i, j],
                (f_n * n[j] + f_1 * r_1[j] + f_2 * r_2[j] + f_3 * r_3[j],),
            )


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
