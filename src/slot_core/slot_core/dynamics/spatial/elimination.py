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

from slot_core.compiled import helper
from slot_core.dynamics.algebra import cross, dot, plus, row
from slot_core.dynamics.lanes import largest, like
from slot_core.dynamics.spatial.floor_contact import add_contact
from slot_core.dynamics.spatial.hinge import Symmetric, bend
from slot_core.dynamics.spatial.quadratic_form import Form, dot4, factor, solve, sum_of
from slot_core.dynamics.spatial.strain import frame


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
        form = add_contact(model, leg, k, 1, inv, place, form)
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
    normal = rod.axial[k] * (
        whole * s.extension[k] + beta * s.extension_rate[k] + s.lag[k, 3]
    )
    normal += leg.pull[0] * along
    before = (row(leg.frame, 0), row(leg.frame, 1), row(leg.frame, 2))
    if k > 0:
        before = frame(s, k - 1)
    hinge = bend(rod, s, k, before, viscous, normal, model.tendon, leg.pull[0])
    # Contact of the segment's begin moves with X_k and Phi_k.
    m = hinge.moment
    begin = add_contact(
        model, leg, k, 0, inv, place, _spun(rod, leg, k, inv, form, hinge)
    )
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
    ux, uy, uz = (
        _arm(fx, t, per_length),
        _arm(fy, t, per_length),
        _arm(fz, t, per_length),
    )
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
    pivot = factor(
        P.xx + 2.0 * ax[0] + wx[0] + axial * p[0] * p[0] + 2.0 * t[0] * g[0] + own,
        P.xy + ax[1] + ay[0] + wx[1] + axial * p[0] * p[1] + t[0] * g[1] + t[1] * g[0],
        P.xz + ax[2] + az[0] + wx[2] + axial * p[0] * p[2] + t[0] * g[2] + t[2] * g[0],
        dot(form.x, t)
        + turning[0]
        + axial * p[0] * pw
        + half * (moment[0] - mt * t[0]),
        P.yy + 2.0 * ay[1] + wy[1] + axial * p[1] * p[1] + 2.0 * t[1] * g[1] + own,
        P.yz + ay[2] + az[1] + wy[2] + axial * p[1] * p[2] + t[1] * g[2] + t[2] * g[1],
        dot(form.y, t)
        + turning[1]
        + axial * p[1] * pw
        + half * (moment[1] - mt * t[1]),
        P.zz + 2.0 * az[2] + wz[2] + axial * p[2] * p[2] + 2.0 * t[2] * g[2] + own,
        dot(form.z, t)
        + turning[2]
        + axial * p[2] * pw
        + half * (moment[2] - mt * t[2]),
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
    rc = _lift(
        plus(form.pull, along, t), plus(form.twist, 1.0, hinge.tendon), t, per_length
    )
    ro = _lift(force, moment, t, per_length)
    w1, w2, w3 = solve(pivot, x1), solve(pivot, x2), solve(pivot, x3)
    z1, z2, z3 = solve(pivot, r1), solve(pivot, r2), solve(pivot, r3)
    wc, wo = solve(pivot, rc), solve(pivot, ro)
    _store(leg.back[k], w1, w2, w3, z1, z2, z3, wc, wo)
    c, o, h = form.pull, form.force, hinge.tendon
    form = Form(
        Symmetric(
            P.xx + B.xx - dot4(x1, w1),
            P.xy + B.xy - dot4(x1, w2),
            P.xz + B.xz - dot4(x1, w3),
            P.yy + B.yy - dot4(x2, w2),
            P.yz + B.yz - dot4(x2, w3),
            P.zz + B.zz - dot4(x3, w3),
        ),
        (-dot4(x1, z1), -dot4(x1, z2), -dot4(x1, z3)),
        (-dot4(x2, z1), -dot4(x2, z2), -dot4(x2, z3)),
        (-dot4(x3, z1), -dot4(x3, z2), -dot4(x3, z3)),
        Symmetric(
            K.xx + axial * bulge[0] * bulge[0] - dot4(r1, z1),
            K.xy + axial * bulge[0] * bulge[1] - dot4(r1, z2),
            K.xz + axial * bulge[0] * bulge[2] - dot4(r1, z3),
            K.yy + axial * bulge[1] * bulge[1] - dot4(r2, z2),
            K.yz + axial * bulge[1] * bulge[2] - dot4(r2, z3),
            K.zz + axial * bulge[2] * bulge[2] - dot4(r3, z3),
        ),
        (c[0] - dot4(x1, wc), c[1] - dot4(x2, wc), c[2] - dot4(x3, wc)),
        (-h[0] - dot4(r1, wc), -h[1] - dot4(r2, wc), -h[2] - dot4(r3, wc)),
        (
            o[0] + begin.force[0] - dot4(x1, wo),
            o[1] + begin.force[1] - dot4(x2, wo),
            o[2] + begin.force[2] - dot4(x3, wo),
        ),
        (-m[0] - dot4(r1, wo), -m[1] - dot4(r2, wo), -m[2] - dot4(r3, wo)),
    )
    return form, pivot.positive, both - dot4(rc, wc), one - dot4(rc, wo)


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
    t, before, inertia = (
        row(leg.segments.direction, k),
        leg.spin_before,
        rod.spin[k] * inv,
    )
    o, m, own = form.moment, hinge.moment, leg.spin[k]
    zero = (0.0 * own, 0.0 * own, 0.0 * own)
    none = Symmetric(zero[0], zero[0], zero[0], zero[0], zero[0], zero[0])
    moment = (
        o[0] + m[0] + inertia * (own * t[0] - before[k, 0]),
        o[1] + m[1] + inertia * (own * t[1] - before[k, 1]),
        o[2] + m[2] + inertia * (own * t[2] - before[k, 2]),
    )
    turn = sum_of(form.turn, hinge.tangent)
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
    return Form(
        place,
        form.x,
        form.y,
        form.z,
        form.turn,
        form.pull,
        form.twist,
        force,
        form.moment,
    )


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
    return (
        a[0] + share * p[0],
        a[1] + share * p[1],
        a[2] + share * p[2],
        dot(t, c) + share * pw,
    )


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
    F[0, 0], F[0, 1], F[0, 2], F[1, 1], F[1, 2], F[2, 2] = (
        P.xx,
        P.xy,
        P.xz,
        P.yy,
        P.yz,
        P.zz,
    )
    F[3, 3], F[3, 4], F[3, 5], F[4, 4], F[4, 5], F[5, 5] = (
        T.xx,
        T.xy,
        T.xz,
        T.yy,
        T.yz,
        T.zz,
    )
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
    a, b = (
        _row(leg.back, k, 0, X, turn, tension),
        _row(leg.back, k, 1, X, turn, tension),
    )
    c, w = (
        _row(leg.back, k, 2, X, turn, tension),
        _row(leg.back, k, 3, X, turn, tension),
    )
    t, scale = row(leg.segments.direction, k), leg.segments.per_length[k]
    r = cross(t, (a, b, c))
    r = (scale * r[0] + w * t[0], scale * r[1] + w * t[1], scale * r[2] + w * t[2])
    return (X[0] + a, X[1] + b, X[2] + c), r, w


@helper
def _row(back, k, r, X, turn, tension):
    value = back[k, r, 7] + back[k, r, 6] * tension
    value += back[k, r, 0] * X[0] + back[k, r, 1] * X[1] + back[k, r, 2] * X[2]
    return -(
        value
        + back[k, r, 3] * turn[0]
        + back[k, r, 4] * turn[1]
        + back[k, r, 5] * turn[2]
    )
