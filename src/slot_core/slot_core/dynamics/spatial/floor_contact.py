"""Forces of the floor on the edges of a spatial leg, as parts of its quadratic form."""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from slot_core.compiled import helper
from slot_core.dynamics.algebra import cross, dot, plus, row
from slot_core.dynamics.contact import (
    coefficient,
    friction_force,
    normal_force,
    tangential,
)
from slot_core.dynamics.lanes import any_lane, like, where
from slot_core.dynamics.spatial.hinge import Symmetric
from slot_core.dynamics.spatial.quadratic_form import Form, sum_of
from slot_core.dynamics.terrain import ground, is_uneven, tilted


@helper
def add_contact(model, leg, k, end, inv, place, form):
    """Add the floor's forces on both edges of segment k at its begin or end (0, 1)."""
    floor, i = model.floor, k + end
    if i < floor.first:
        return form
    for side in range(2):
        reach = floor.half_width if side else -floor.half_width
        form = _add_corner(
            model, leg, k, i, 4 * k + 2 * end + side, reach, inv, place, form
        )
    return form


@helper
def _add_corner(model, leg, k, i, p, reach, inv, place, form):
    """Add the floor's force on contact point p at node i and `reach` (m) along the director."""
    floor, f, d = model.floor, leg.field, row(leg.segments.director, k)
    a = (reach * d[0], reach * d[1], reach * d[2])
    x, y, z = (
        leg.root[0] + leg.stage[i, 0] + a[0],
        leg.root[1] + leg.stage[i, 1] + a[1],
        leg.root[2] + leg.stage[i, 2] + a[2],
    )
    up = (f[2, 0], f[2, 1], f[2, 2])
    gap = place[2] + up[0] * x + up[1] * y + up[2] * z
    if is_uneven(floor.terrain):
        east = place[0] + f[0, 0] * x + f[0, 1] * y + f[0, 2] * z
        north = place[1] + f[1, 0] * x + f[1, 1] * y + f[1, 2] * z
        below = ground(floor.terrain, east, north)
        gap, up = tilted(f, below, gap - below.height)
        if floor.bristle > 0.0:
            leg.slope[p, 0], leg.slope[p, 1] = below.slope_x, below.slope_y
    if floor.bristle > 0.0:
        leg.limit[p] = like(0.0, gap)
    if any_lane(gap < 0.0):
        return _touch(floor, leg, k, i, p, a, gap, up, inv, form)
    return form


@helper
def _touch(floor, leg, k, i, p, a, gap, up, inv, form):
    """Add the floor's force on a point at a (3 numbers), m, from node i, and its tangent."""
    w = angular_velocity(leg, k)
    u = plus(row(leg.velocity, i), 1.0, cross(w, a))
    vn = dot(up, u)
    v = plus(u, -vn, up)
    stiffness, damping = floor.stiffness[p], floor.damping[p]
    normal = normal_force(stiffness, damping, gap, vn)
    mu = coefficient(
        floor, leg.friction[0], leg.friction[1], leg.rate[0], v[0], dot(v, v)
    )
    bristle = v
    if floor.bristle > 0.0:
        leg.limit[p] = mu * normal
        bristle = tangential(leg.field, leg.bristle[p], up)
    hold = friction_force(floor, mu * normal, 1.0 / inv, stiffness, damping, bristle, v)
    drag = hold.drag * inv
    stiff = where(normal > 0.0, stiffness + damping * inv - drag, like(0.0, drag))
    # Force on the floor, tangent C = drag 1 + stiff up up^T, and its coupling -C [a] to Phi.
    g = (
        hold.drag * v[0] + hold.x - normal * up[0],
        hold.drag * v[1] + hold.y - normal * up[1],
        hold.drag * v[2] + hold.z - normal * up[2],
    )
    s = (stiff * up[0], stiff * up[1], stiff * up[2])
    C = Symmetric(
        drag + s[0] * up[0],
        s[0] * up[1],
        s[0] * up[2],
        drag + s[1] * up[1],
        s[1] * up[2],
        drag + s[2] * up[2],
    )
    bx, by, bz = (
        cross(a, (C.xx, C.xy, C.xz)),
        cross(a, (C.xy, C.yy, C.yz)),
        cross(a, (C.xz, C.yz, C.zz)),
    )
    t1, t2, t3 = (
        cross(a, (bx[0], by[0], bz[0])),
        cross(a, (bx[1], by[1], bz[1])),
        cross(a, (bx[2], by[2], bz[2])),
    )
    # The arm a turns with the segment: -(Phi x a) x f, f = -g, without its antisymmetric part.
    level = -dot(a, g)
    T = form.turn
    turn = Symmetric(
        T.xx + t1[0] + a[0] * g[0] + level,
        T.xy + t2[0] + 0.5 * (a[0] * g[1] + a[1] * g[0]),
        T.xz + t3[0] + 0.5 * (a[0] * g[2] + a[2] * g[0]),
        T.yy + t2[1] + a[1] * g[1] + level,
        T.yz + t3[1] + 0.5 * (a[1] * g[2] + a[2] * g[1]),
        T.zz + t3[2] + a[2] * g[2] + level,
    )
    return Form(
        sum_of(form.place, C),
        plus(form.x, 1.0, bx),
        plus(form.y, 1.0, by),
        plus(form.z, 1.0, bz),
        turn,
        form.pull,
        form.twist,
        plus(form.force, 1.0, g),
        plus(form.moment, 1.0, cross(a, g)),
    )


@helper
def angular_velocity(leg, k):
    """Angular velocity of segment k at the stage, rad/s, in leg axes."""
    s, v = leg.segments, leg.velocity
    t, own, scale = row(s.direction, k), leg.spin[k], s.per_length[k]
    w = cross(t, (v[k + 1, 0] - v[k, 0], v[k + 1, 1] - v[k, 1], v[k + 1, 2] - v[k, 2]))
    return (
        scale * w[0] + own * t[0],
        scale * w[1] + own * t[1],
        scale * w[2] + own * t[2],
    )
