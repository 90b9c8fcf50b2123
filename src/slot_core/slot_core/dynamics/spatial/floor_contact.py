"""Forces of the floor on the edges of a spatial leg, as parts of its quadratic form.

A contact point lies at the arm a from node i, half the leg's width along the director of segment k
or against it. It moves with the velocity u of its segment:

    u = V_i + w x a,      w = t x (V_{k+1} - V_k) / l + Omega t.

With the floor's normal n, the gap g and the friction law of `contact.py`, the floor's force on it is

    f = N n - drag v - held,      N = max(0, -k g - d u.n),      v = u - (u.n) n.

In a Newton iteration the point is displaced by X + Phi x a, which changes its velocity by
1 / (theta h) times as much. The tangent -df is

    C = c 1 + s n n^T,      c = drag / (theta h),      s = k + d / (theta h) - c while N > 0, else 0,

over X, and C mapped by Phi -> Phi x a over Phi. The arm turns with the segment; the moment of f
about the node adds the symmetric part of Phi -> -(Phi x a) x f.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from slot_core.compiled import helper
from slot_core.dynamics.algebra import add, cross, dot, minus, plus, row, scaled
from slot_core.dynamics.contact import (
    coefficient,
    friction_force,
    normal_force,
    tangential,
)
from slot_core.dynamics.lanes import any_lane, like, where
from slot_core.dynamics.spatial.hinge import Symmetric, rows
from slot_core.dynamics.spatial.quadratic_form import Form, sum_of
from slot_core.dynamics.terrain import clearance


@helper
def add_contact(model, leg, k, end, inv, place, form):
    """Add the floor's forces on both edges of segment k at its begin or end (0, 1) to the form.

    inv = 1 / (theta h), 1/s; place: torso's centre in odom, m. Writes the points' friction limits
    and the floor's slopes below them, which bristles need at the end of the step.
    """
    floor, i = model.floor, k + end
    if i < floor.first:
        return form
    root = (leg.root[0], leg.root[1], leg.root[2])
    d = row(leg.segments.director, k)
    for side in range(2):
        p = 4 * k + 2 * end + side
        arm = scaled(floor.half_width if side else -floor.half_width, d)
        point = add(add(root, row(leg.stage, i)), arm)
        gap, up, below = clearance(floor.terrain, place, leg.field, point)
        if floor.bristle > 0.0:
            leg.limit[p] = like(0.0, gap)
            leg.slope[p, 0] = below.slope_x
            leg.slope[p, 1] = below.slope_y
        if any_lane(gap < 0.0):
            form = _touch(floor, leg, k, i, p, arm, gap, up, inv, form)
    return form


@helper
def _touch(floor, leg, k, i, p, a, gap, up, inv, form):
    """Add the floor's force on contact point p and its tangent to the form.

    i: its node; a (3 numbers): its arm, m; gap, m; up (3 numbers): the floor's normal, leg axes.
    g = -f is the gradient that the force adds.
    """
    u = add(row(leg.velocity, i), cross(angular_velocity(leg, k), a))
    vn = dot(up, u)
    v = plus(u, -vn, up)
    stiffness, damping = floor.stiffness[p], floor.damping[p]
    normal = normal_force(stiffness, damping, gap, vn)
    own, other = leg.friction[0], leg.friction[1]
    mu = coefficient(floor, own, other, leg.rate[0], v[0], dot(v, v))
    bristle = v
    if floor.bristle > 0.0:
        leg.limit[p] = mu * normal
        bristle = tangential(leg.field, leg.bristle[p], up)
    hold = friction_force(
        floor, mu * normal, 1.0 / inv, stiffness, damping, bristle, v
    )
    g = minus(add(scaled(hold.drag, v), hold.held), scaled(normal, up))
    drag = hold.drag * inv
    stiff = where(
        normal > 0.0, stiffness + damping * inv - drag, like(0.0, drag)
    )
    s = scaled(stiff, up)
    C = Symmetric(
        xx=drag + s[0] * up[0],
        xy=s[0] * up[1],
        xz=s[0] * up[2],
        yy=drag + s[1] * up[1],
        yz=s[1] * up[2],
        zz=drag + s[2] * up[2],
    )
    cx, cy, cz = rows(C)
    bx, by, bz = cross(a, cx), cross(a, cy), cross(a, cz)
    tx = cross(a, (bx[0], by[0], bz[0]))
    ty = cross(a, (bx[1], by[1], bz[1]))
    tz = cross(a, (bx[2], by[2], bz[2]))
    level = -dot(a, g)
    T = form.turn
    turn = Symmetric(
        xx=T.xx + tx[0] + a[0] * g[0] + level,
        xy=T.xy + ty[0] + 0.5 * (a[0] * g[1] + a[1] * g[0]),
        xz=T.xz + tz[0] + 0.5 * (a[0] * g[2] + a[2] * g[0]),
        yy=T.yy + ty[1] + a[1] * g[1] + level,
        yz=T.yz + tz[1] + 0.5 * (a[1] * g[2] + a[2] * g[1]),
        zz=T.zz + tz[2] + a[2] * g[2] + level,
    )
    return Form(
        place=sum_of(form.place, C),
        x=add(form.x, bx),
        y=add(form.y, by),
        z=add(form.z, bz),
        turn=turn,
        pull=form.pull,
        twist=form.twist,
        force=add(form.force, g),
        moment=add(form.moment, cross(a, g)),
    )


@helper
def angular_velocity(leg, k):
    """Angular velocity of segment k at the stage, rad/s, in leg axes."""
    t, v = row(leg.segments.direction, k), leg.velocity
    turning = cross(t, minus(row(v, k + 1), row(v, k)))
    return plus(scaled(leg.segments.per_length[k], turning), leg.spin[k], t)
