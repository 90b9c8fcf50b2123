"""Elimination of a spatial leg from its tip to its clamp, in one iteration of Newton's method.

The part of a leg beyond node i acts on the rest through the node's displacement X and the rotation
Phi of the segment before it. Its equations are a quadratic form

    F (7 x 8) over (X, Phi, lambda | 1)

with the change lambda of the tendon's tension; the last column is the gradient. Each segment is one
4 x 4 pivot over u = (s, w), the difference of its nodes' displacements and its turn about itself:

    X_i = X_k + s,      Phi_k = t x s / l + t w = A s + t w.

The tangent of a hinge is in `hinge.py`. What is left antisymmetric in the block of one segment
comes from spins not being coordinates; it is left out. The twist about a segment has the inertia of
its section's polar moment. The mass moves linearly between two nodes, which adds -mu (ds/dt)^2 / 2
to the energy of the lumped masses.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

from typing import NamedTuple

from slot_core.compiled import helper
from slot_core.dynamics.algebra import cross, dot, plus, row
from slot_core.dynamics.contact import coefficient, friction_force, normal_force, tangential
from slot_core.dynamics.lanes import any_lane, largest, like, where
from slot_core.dynamics.spatial.hinge import Symmetric, bend
from slot_core.dynamics.spatial.strain import frame
from slot_core.dynamics.terrain import ground, is_uneven, tilted


class Form(NamedTuple):
    """Quadratic form over (X, Phi, lambda | 1) of what lies beyond a node."""

    place: Symmetric  # over X
    x: tuple[float, float, float]  # rows X of the coupling to Phi
    y: tuple[float, float, float]
    z: tuple[float, float, float]
    turn: Symmetric  # over Phi
    pull: tuple[float, float, float]  # column of lambda, rows X
    twist: tuple[float, float, float]  # rows Phi
    force: tuple[float, float, float]  # gradient, rows X
    moment: tuple[float, float, float]  # rows Phi


class Pivot(NamedTuple):
    """Factors L D L^T of a symmetric 4 x 4 matrix: L below the diagonal, 1 / D."""

    l10: float
    l20: float
    l30: float
    l21: float
    l31: float
    l32: float
    d0: float
    d1: float
    d2: float
    d3: float
    positive: bool


@helper
def eliminate(model, leg, inv, place):
    """Eliminate the segments of a leg from tip to clamp; returns whether all pivots were positive.

    Writes leg.form and leg.back. inv = 1 / (theta h); place: the torso's centre in odom, m.
    """
    nothing = like(0.0, leg.friction[0])
    zero = (nothing, nothing, nothing)
    none = Symmetric(nothing, nothing, nothing, nothing, nothing, nothing)
    form = Form(none, zero, zero, zero, none, zero, zero, zero, zero)
    both = one = nothing  # lambda with itself, and its gradient
    definite = True
    for k in range(leg.segments.length.size - 1, -1, -1):
        form = _add_node(model, leg, k + 1, inv, form)
        form = _add_contact(model, leg, k, 1, inv, place, form)
        form, positive, both, one = _reduce(model, leg, k, inv, place, form, both, one)
        definite = definite & positive
    form = _add_node(model, leg, 0, inv, form)
    _write(leg.form, form, both, one)
    return definite


@helper
def _reduce(model, leg, k, inv, place, form, both, one):
    """Eliminate segment k: the form over its begin and over the segment before it."""
    s, rod = leg.segments, model.rod
    t, per_length, along = row(s.direction, k), s.per_length[k], model.tendon.along[k]
    whole, beta = 1.0 + s.firm[0], rod.damping_time
    viscous = whole + beta * inv
    axial = viscous * rod.axial[k]
    normal = rod.axial[k] * (whole * s.extension[k] + beta * s.extension_rate[k] + s.lag[k, 3])
    normal += leg.pull[0] * along
    before = (row(leg.frame, 0), row(leg.frame, 1), row(leg.frame, 2))
    if k > 0:
        before = frame(s, k - 1)
    hinge = bend(rod, s, k, before, viscous, normal, model.tendon, leg.pull[0])
    # Contact of the segment's begin moves with X_k and Phi_k.
    m = hinge.moment
    begin = _add_contact(model, leg, k, 0, inv, place, _spun(rod, leg, k, inv, form, hinge))
    moment, turn = begin.moment, begin.turn
    P, B = form.place, begin.place
    ax, ay, az = (
        _arm(form.x, t, per_length),
        _arm(form.y, t, per_length),
        _arm(form.z, t, per_length),
    )
    bx, by, bz = (
        _arm(begin.x, t, per_length),
        _arm(begin.y, t, per_length),
        _arm(begin.z, t, per_length),
    )
    # Columns of X_k over u.
    x1 = (
        P.xx + ax[0] + bx[0],
        P.xy + ax[1] + bx[1],
        P.xz + ax[2] + bx[2],
        dot(form.x, t) + dot(begin.x, t),
    )
    x2 = (
        P.xy + ay[0] + by[0],
        P.yy + ay[1] + by[1],
        P.yz + ay[2] + by[2],
        dot(form.y, t) + dot(begin.y, t),
    )
    x3 = (
        P.xz + az[0] + bz[0],
        P.yz + az[1] + bz[1],
        P.zz + az[2] + bz[2],
        dot(form.z, t) + dot(begin.z, t),
    )
    # The pivot: the form beyond, stretch with p = d(l - c) over u, and geometric stiffness.
    fx, fy, fz = (
        (turn.xx, turn.xy, turn.xz),
        (turn.xy, turn.yy, turn.yz),
        (turn.xz, turn.yz, turn.zz),
    )
    ft = (dot(fx, t), dot(fy, t), dot(fz, t))
    ux, uy, uz = _arm(fx, t, per_length), _arm(fy, t, per_length), _arm(fz, t, per_length)
    wx, wy, wz = (
        _arm((ux[0], uy[0], uz[0]), t, per_length),
        _arm((ux[1], uy[1], uz[1]), t, per_length),
        _arm((ux[2], uy[2], uz[2]), t, per_length),
    )
    bulge = hinge.bulge
    p, pw = plus(t, 1.0, _arm(bulge, t, per_length)), dot(bulge, t)
    across, mt = normal * per_length, dot(moment, t)
    q, square, half = cross(t, moment), per_length * per_length, 0.5 * per_length
    g = (
        square * q[0] - 0.5 * across * t[0],
        square * q[1] - 0.5 * across * t[1],
        square * q[2] - 0.5 * across * t[2],
    )
    own = across - inv * inv * rod.coupling[k]
    turning = _arm(ft, t, per_length)
    pivot = _factor(
        P.xx + 2.0 * ax[0] + wx[0] + axial * p[0] * p[0] + 2.0 * t[0] * g[0] + own,
        P.xy + ax[1] + ay[0] + wx[1] + axial * p[0] * p[1] + t[0] * g[1] + t[1] * g[0],
        P.xz + ax[2] + az[0] + wx[2] + axial * p[0] * p[2] + t[0] * g[2] + t[2] * g[0],
        dot(form.x, t) + turning[0] + axial * p[0] * pw + half * (moment[0] - mt * t[0]),
        P.yy + 2.0 * ay[1] + wy[1] + axial * p[1] * p[1] + 2.0 * t[1] * g[1] + own,
        P.yz + ay[2] + az[1] + wy[2] + axial * p[1] * p[2] + t[1] * g[2] + t[2] * g[1],
        dot(form.y, t) + turning[1] + axial * p[1] * pw + half * (moment[1] - mt * t[1]),
        P.zz + 2.0 * az[2] + wz[2] + axial * p[2] * p[2] + 2.0 * t[2] * g[2] + own,
        dot(form.z, t) + turning[2] + axial * p[2] * pw + half * (moment[2] - mt * t[2]),
        dot(ft, t) + axial * pw * pw + rod.spin[k] * inv * inv,
    )
    # Columns of Phi_{k-1} over u: P^T (-K - [m] / 2) - axial p bulge^T.
    K = hinge.tangent
    c1 = (-K.xx, -K.xy - 0.5 * m[2], -K.xz + 0.5 * m[1])
    c2 = (-K.xy + 0.5 * m[2], -K.yy, -K.yz - 0.5 * m[0])
    c3 = (-K.xz - 0.5 * m[1], -K.yz + 0.5 * m[0], -K.zz)
    r1 = _column(c1, t, per_length, p, pw, -axial * bulge[0])
    r2 = _column(c2, t, per_length, p, pw, -axial * bulge[1])
    r3 = _column(c3, t, per_length, p, pw, -axial * bulge[2])
    # Columns of lambda and of the gradient.
    force = plus(plus(form.force, normal, t), -inv * rod.coupling[k], _lag(leg, k))
    rc = _lift(plus(form.pull, along, t), plus(form.twist, 1.0, hinge.tendon), t, per_length)
    ro = _lift(force, moment, t, per_length)
    w1, w2, w3 = _solve(pivot, x1), _solve(pivot, x2), _solve(pivot, x3)
    z1, z2, z3 = _solve(pivot, r1), _solve(pivot, r2), _solve(pivot, r3)
    wc, wo = _solve(pivot, rc), _solve(pivot, ro)
    _store(leg.back[k], w1, w2, w3, z1, z2, z3, wc, wo)
    c, o, h = form.pull, form.force, hinge.tendon
    form = Form(
        Symmetric(
            P.xx + B.xx - _dot(x1, w1), P.xy + B.xy - _dot(x1, w2), P.xz + B.xz - _dot(x1, w3),
            P.yy + B.yy - _dot(x2, w2), P.yz + B.yz - _dot(x2, w3), P.zz + B.zz - _dot(x3, w3),
        ),
        (-_dot(x1, z1), -_dot(x1, z2), -_dot(x1, z3)),
        (-_dot(x2, z1), -_dot(x2, z2), -_dot(x2, z3)),
        (-_dot(x3, z1), -_dot(x3, z2), -_dot(x3, z3)),
        Symmetric(
            K.xx + axial * bulge[0] * bulge[0] - _dot(r1, z1),
            K.xy + axial * bulge[0] * bulge[1] - _dot(r1, z2),
            K.xz + axial * bulge[0] * bulge[2] - _dot(r1, z3),
            K.yy + axial * bulge[1] * bulge[1] - _dot(r2, z2),
            K.yz + axial * bulge[1] * bulge[2] - _dot(r2, z3),
            K.zz + axial * bulge[2] * bulge[2] - _dot(r3, z3),
        ),
        (c[0] - _dot(x1, wc), c[1] - _dot(x2, wc), c[2] - _dot(x3, wc)),
        (-h[0] - _dot(r1, wc), -h[1] - _dot(r2, wc), -h[2] - _dot(r3, wc)),
        (
            o[0] + begin.force[0] - _dot(x1, wo),
            o[1] + begin.force[1] - _dot(x2, wo),
            o[2] + begin.force[2] - _dot(x3, wo),
        ),
        (-m[0] - _dot(r1, wo), -m[1] - _dot(r2, wo), -m[2] - _dot(r3, wo)),
    )  # fmt: skip
    return form, pivot.positive, both - _dot(rc, wc), one - _dot(rc, wo)


@helper
def _lag(leg, k):
    """Change of V - V_n along segment k, m/s."""
    v, before = leg.velocity, leg.before
    return (
        v[k + 1, 0] - v[k, 0] - before[k + 1, 0] + before[k, 0],
        v[k + 1, 1] - v[k, 1] - before[k + 1, 1] + before[k, 1],
        v[k + 1, 2] - v[k, 2] - before[k + 1, 2] + before[k, 2],
    )


@helper
def _spun(rod, leg, k, inv, form, hinge):
    """Form over (X_k, Phi_k) of the turn of segment k alone: beyond it, its hinge and its spin."""
    t, before, inertia = row(leg.segments.direction, k), leg.spin_before, rod.spin[k] * inv
    o, m, own = form.moment, hinge.moment, leg.spin[k]
    zero = (0.0 * own, 0.0 * own, 0.0 * own)
    none = Symmetric(zero[0], zero[0], zero[0], zero[0], zero[0], zero[0])
    moment = (
        o[0] + m[0] + inertia * (own * t[0] - before[k, 0]),
        o[1] + m[1] + inertia * (own * t[1] - before[k, 1]),
        o[2] + m[2] + inertia * (own * t[2] - before[k, 2]),
    )
    turn = _sum(form.turn, hinge.tangent)
    return Form(none, zero, zero, zero, turn, zero, zero, zero, moment)


@helper
def _add_node(model, leg, i, inv, form):
    """Add inertia and weight of node i to the form."""
    mass, o, P = model.rod.mass[i], form.force, form.place
    rate, inertia = mass * inv, mass * inv * inv
    force = (
        o[0] + rate * (leg.velocity[i, 0] - leg.before[i, 0]) - mass * leg.field[3, 0],
        o[1] + rate * (leg.velocity[i, 1] - leg.before[i, 1]) - mass * leg.field[3, 1],
        o[2] + rate * (leg.velocity[i, 2] - leg.before[i, 2]) - mass * leg.field[3, 2],
    )
    place = Symmetric(P.xx + inertia, P.xy, P.xz, P.yy + inertia, P.yz, P.zz + inertia)
    return Form(place, form.x, form.y, form.z, form.turn, form.pull, form.twist, force, form.moment)


@helper
def _add_contact(model, leg, k, end, inv, place, form):
    """Add the floor's forces on both edges of segment k at its begin or end (0, 1)."""
    floor, i = model.floor, k + end
    if i < floor.first:
        return form
    for side in range(2):
        reach = floor.half_width if side else -floor.half_width
        form = _add_corner(model, leg, k, i, 4 * k + 2 * end + side, reach, inv, place, form)
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
    mu = coefficient(floor, leg.friction[0], leg.friction[1], leg.rate[0], v[0], dot(v, v))
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
        drag + s[0] * up[0], s[0] * up[1], s[0] * up[2], drag + s[1] * up[1], s[1] * up[2],
        drag + s[2] * up[2],
    )  # fmt: skip
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
        _sum(form.place, C),
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
    return scale * w[0] + own * t[0], scale * w[1] + own * t[1], scale * w[2] + own * t[2]


@helper
def _sum(a, b):
    """Sum of two symmetric matrices."""
    return Symmetric(a.xx + b.xx, a.xy + b.xy, a.xz + b.xz, a.yy + b.yy, a.yz + b.yz, a.zz + b.zz)


@helper
def _arm(r, t, per_length):
    """r A for a row r: (r x t) / l, since A s = t x s / l."""
    c = cross(r, t)
    return per_length * c[0], per_length * c[1], per_length * c[2]


@helper
def _lift(force, moment, t, per_length):
    """Right-hand side of u = (s, w) of a force on the segment's end and a moment on the segment."""
    a = _arm(moment, t, per_length)
    return force[0] + a[0], force[1] + a[1], force[2] + a[2], dot(t, moment)


@helper
def _column(c, t, per_length, p, pw, share):
    """Right-hand side of u of a moment c on the segment, and share times the stretch (p, pw)."""
    a = _arm(c, t, per_length)
    return a[0] + share * p[0], a[1] + share * p[1], a[2] + share * p[2], dot(t, c) + share * pw


@helper
def _factor(xx, xy, xz, xw, yy, yz, yw, zz, zw, ww):
    """Factors of a symmetric 4 x 4 matrix, and whether it is positive definite."""
    d0 = 1.0 / xx
    l10, l20, l30 = xy * d0, xz * d0, xw * d0
    yy, yz, yw = yy - l10 * xy, yz - l10 * xz, yw - l10 * xw
    d1 = 1.0 / yy
    l21, l31 = yz * d1, yw * d1
    zz, zw = zz - l20 * xz - l21 * yz, zw - l20 * xw - l21 * yw
    d2 = 1.0 / zz
    l32 = zw * d2
    ww = ww - l30 * xw - l31 * yw - l32 * zw
    positive = (xx > 0.0) & (yy > 0.0) & (zz > 0.0) & (ww > 0.0)
    return Pivot(l10, l20, l30, l21, l31, l32, d0, d1, d2, 1.0 / ww, positive)


@helper
def _solve(p, r):
    """Solution of the pivot's system for a right-hand side of four numbers."""
    b = r[1] - p.l10 * r[0]
    c = r[2] - p.l20 * r[0] - p.l21 * b
    d = r[3] - p.l30 * r[0] - p.l31 * b - p.l32 * c
    d = d * p.d3
    c = c * p.d2 - p.l32 * d
    b = b * p.d1 - p.l21 * c - p.l31 * d
    return r[0] * p.d0 - p.l10 * b - p.l20 * c - p.l30 * d, b, c, d


@helper
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@helper
def _store(back, w1, w2, w3, z1, z2, z3, wc, wo):
    """Store the rows of -u over (X, Phi, lambda, 1) for the back substitution."""
    for r in range(4):
        back[r, 0], back[r, 1], back[r, 2] = w1[r], w2[r], w3[r]
        back[r, 3], back[r, 4], back[r, 5] = z1[r], z2[r], z3[r]
        back[r, 6], back[r, 7] = wc[r], wo[r]


@helper
def _write(F, form, both, one):
    """Write the form at the clamp to F (7, 8)."""
    P, T = form.place, form.turn
    F[0, 0], F[0, 1], F[0, 2], F[1, 1], F[1, 2], F[2, 2] = P.xx, P.xy, P.xz, P.yy, P.yz, P.zz
    F[3, 3], F[3, 4], F[3, 5], F[4, 4], F[4, 5], F[5, 5] = T.xx, T.xy, T.xz, T.yy, T.yz, T.zz
    for c in range(3):
        F[0, 3 + c], F[1, 3 + c], F[2, 3 + c] = form.x[c], form.y[c], form.z[c]
        F[c, 6], F[3 + c, 6] = form.pull[c], form.twist[c]
        F[c, 7], F[3 + c, 7] = form.force[c], form.moment[c]
    F[6, 6], F[6, 7] = both, one
    for r in range(1, 7):
        for c in range(r):
            F[r, c] = F[c, r]


@helper
def substitute(leg, vector, inv):
    """Back substitution of the torso's increments in a leg; updates V, the spins and the tension.

    Returns the largest squared change of a node's velocity, (m/s)^2.
    """
    L, release, moved = leg.clamp, leg.release, leg.moved
    tension = release[6]
    for r in range(6):
        value = L[r, 0] * vector[0]
        for c in range(1, 6):
            value += L[r, c] * vector[c]
        moved[r] = value
        tension += release[r] * value
    leg.pull[0] = max(0.0, leg.pull[0] + tension)
    X, turn = (moved[0], moved[1], moved[2]), (moved[3], moved[4], moved[5])
    most = _move(leg, 0, X, inv, like(0.0, tension))
    for k in range(leg.segments.length.size):
        X, turn, w = follow(leg, k, X, turn, tension)
        leg.spin[k] += w * inv
        most = _move(leg, k + 1, X, inv, most)
    return largest(most) * inv * inv


@helper
def _move(leg, i, X, inv, most):
    """Add a displacement to the velocity of node i; the largest squared displacement so far."""
    leg.velocity[i, 0] += X[0] * inv
    leg.velocity[i, 1] += X[1] * inv
    leg.velocity[i, 2] += X[2] * inv
    return max(most, dot(X, X))


@helper
def follow(leg, k, X, turn, tension):
    """Displacement of a segment's end, its rotation and its turn w, from those at its begin."""
    a, b = _row(leg.back, k, 0, X, turn, tension), _row(leg.back, k, 1, X, turn, tension)
    c, w = _row(leg.back, k, 2, X, turn, tension), _row(leg.back, k, 3, X, turn, tension)
    t, scale = row(leg.segments.direction, k), leg.segments.per_length[k]
    r = cross(t, (a, b, c))
    r = (scale * r[0] + w * t[0], scale * r[1] + w * t[1], scale * r[2] + w * t[2])
    return (X[0] + a, X[1] + b, X[2] + c), r, w


@helper
def _row(back, k, r, X, turn, tension):
    value = back[k, r, 7] + back[k, r, 6] * tension
    value += back[k, r, 0] * X[0] + back[k, r, 1] * X[1] + back[k, r, 2] * X[2]
    return -(value + back[k, r, 3] * turn[0] + back[k, r, 4] * turn[1] + back[k, r, 5] * turn[2])
