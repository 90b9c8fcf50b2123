"""Elimination of a spatial leg from its tip to its clamp, in one iteration of Newton's method.

The part of a leg beyond node i acts on the rest through the node's displacement X and the rotation
Phi of the segment before it. Its equations are a quadratic form

    F (7 x 8) over (X, Phi, lambda | 1)

with the change lambda of the tendon's tension; the last column is the gradient. Each segment is one
4 x 4 pivot over u = (s, w), the difference of its nodes' displacements and its turn about itself:

    X_i = X_k + s,      Phi_k = t x s / l + t w = A s + t w.

With the form F beyond node i, the hinge at node k and the contact at the segment's begin, the
equations of the segment over (u, Y, lambda | 1), Y = (X_k, Phi_{k-1}), have the blocks

    [ D    R^T ]      D (4 x 4): pivot over u,      R: rows of Y and lambda, and the gradient,
    [ R    S   ]

so that u = -D^-1 R^T (Y, lambda, 1) and the form over Y is the Schur complement S - R D^-1 R^T. The
back substitution goes from the clamp to the tip (`follow`).

At the clamp a taut tendon adds lambda dl - lambda^2 / (2 kappa) with kappa = k + c / (theta h), in
place of its full matrix kappa grad l grad l^T, and lambda is eliminated too (`couple`).

The tangent of a hinge is in `hinge.py`. An antisymmetric rest in the block of one
segment comes from spins not being coordinates; it is left out. The twist about a segment has the inertia of
its section's polar moment. The mass moves linearly between two nodes, which adds -mu (ds/dt)^2 / 2
to the energy of the lumped masses.

`Form` is F, and `Pivot` holds the factors of D.

The floor acts on the edges of a leg. A contact point lies
at the arm a from node i, half the leg's width along the director of segment k
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

from slot_core.arrays import named
from slot_core.compiled import helper
from slot_core.dynamics.algebra import (
    add,
    cross,
    dot,
    minus,
    plus,
    put,
    row,
    scaled,
)
from slot_core.dynamics.contact import (
    clearance,
    coefficient,
    friction_force,
    normal_force,
    tangential,
)
from slot_core.dynamics.lanes import any_lane, largest, like, total, where
from slot_core.dynamics.spatial.hinge import Symmetric, bend, between, rows
from slot_core.dynamics.spatial.strain import frame_before, growth

Form = named(
    "Form",
    [
        "place",  # over X
        "x",  # rows X of the coupling to Phi
        "y",
        "z",
        "turn",  # over Phi
        "pull",  # column of lambda, rows X
        "twist",  # rows Phi
        "force",  # gradient, rows X
        "moment",  # rows Phi
    ],
    __name__,
)
"""Quadratic form over (X, Phi, lambda | 1) of the leg beyond a node."""
Pivot = named("Pivot", "l10 l20 l30 l21 l31 l32 d0 d1 d2 d3 positive", __name__)
"""Factors L D L^T of a symmetric 4 x 4 matrix: L below the diagonal, 1 / D."""


@helper
def sum_of(a, b):
    """Sum of two symmetric matrices."""
    return Symmetric(
        a.xx + b.xx,
        a.xy + b.xy,
        a.xz + b.xz,
        a.yy + b.yy,
        a.yz + b.yz,
        a.zz + b.zz,
    )


@helper
def factor(xx, xy, xz, xw, yy, yz, yw, zz, zw, ww):
    """Factors of a symmetric 4 x 4 matrix, and whether it is positive definite."""
    d0 = 1.0 / xx
    l10 = xy * d0
    l20 = xz * d0
    l30 = xw * d0
    yy = yy - l10 * xy
    yz = yz - l10 * xz
    yw = yw - l10 * xw
    d1 = 1.0 / yy
    l21 = yz * d1
    l31 = yw * d1
    zz = zz - l20 * xz - l21 * yz
    zw = zw - l20 * xw - l21 * yw
    d2 = 1.0 / zz
    l32 = zw * d2
    ww = ww - l30 * xw - l31 * yw - l32 * zw
    positive = (xx > 0.0) & (yy > 0.0) & (zz > 0.0) & (ww > 0.0)
    return Pivot(l10, l20, l30, l21, l31, l32, d0, d1, d2, 1.0 / ww, positive)


@helper
def solve(p, r):
    """Solution of the pivot's system for a right-hand side of four numbers."""
    b = r[1] - p.l10 * r[0]
    c = r[2] - p.l20 * r[0] - p.l21 * b
    d = r[3] - p.l30 * r[0] - p.l31 * b - p.l32 * c
    d = d * p.d3
    c = c * p.d2 - p.l32 * d
    b = b * p.d1 - p.l21 * c - p.l31 * d
    return r[0] * p.d0 - p.l10 * b - p.l20 * c - p.l30 * d, b, c, d


@helper
def dot4(a, b):
    """Product of two rows of four numbers."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@helper
def dots(rows, b):
    """Products of three rows with a fourth, of four numbers each."""
    return dot4(rows[0], b), dot4(rows[1], b), dot4(rows[2], b)


@helper
def less(a, left, right):
    """a - left right^T, symmetric, for blocks of three rows of four numbers."""
    return Symmetric(
        xx=a.xx - dot4(left[0], right[0]),
        xy=a.xy - dot4(left[0], right[1]),
        xz=a.xz - dot4(left[0], right[2]),
        yy=a.yy - dot4(left[1], right[1]),
        yz=a.yz - dot4(left[1], right[2]),
        zz=a.zz - dot4(left[2], right[2]),
    )


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


@helper
def eliminate(model, leg, inv, place):
    """Eliminate the segments of a leg from tip to clamp; returns whether all pivots were positive.

    Writes leg.form (7, 8), the form at the clamp, and leg.back (N-1, 4, 8), rows for `follow`.

    inv = 1 / (theta h), 1/s; place (3,): the torso's centre in odom, m. `load_leg` has
    written strains, tension and frames at the iterate.
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
        form, positive, both, one = _reduce(
            model, leg, k, inv, place, form, both, one
        )
        definite = definite & positive
    form = _add_node(model, leg, 0, inv, form)
    _write(leg.form, form, both, one)
    return definite


@helper
def _reduce(model, leg, k, inv, place, form, both, one):
    """Eliminate segment k: the form over its begin and over the segment before it.

    form: of the leg beyond the segment's end; both, one: its entries of lambda with itself and of
    lambda's gradient. Returns the new form, whether the pivot was positive, and the new entries.

    x, r, pulled, loaded are the columns of X_k, Phi_{k-1}, lambda and the gradient over u, and w,
    z, wc, wo the pivot's solutions for them.
    """
    s, rod = leg.segments, model.rod
    t, scale = row(s.direction, k), s.per_length[k]
    along = model.tendon.along[k]
    whole, beta = 1.0 + s.firm[0], rod.damping_time
    viscous = whole + beta * inv
    axial = viscous * rod.axial[k]
    strain = whole * s.extension[k] + beta * s.extension_rate[k] + s.lag[k, 3]
    normal = rod.axial[k] * strain
    normal += leg.pull[0] * along
    before = frame_before(s, k, leg.frame)
    hinge = bend(rod, s, k, before, viscous, normal, model.tendon, leg.pull[0])
    bulge = hinge.bulge
    # contact of the segment's begin moves with X_k and Phi_k
    begin = _spun(rod, leg, k, inv, form, hinge)
    begin = add_contact(model, leg, k, 0, inv, place, begin)
    stretch = (*add(t, _arm(bulge, t, scale)), dot(bulge, t))  # d(l - c) over u
    inertia = inv * inv * rod.coupling[k]
    spin = rod.spin[k] * inv * inv
    pivot = _pivot(form, begin, t, scale, axial, stretch, normal, inertia, spin)
    # columns of X_k, of Phi_{k-1}: P^T ([m] / 2 - K) - axial p bulge^T, of lambda, of the gradient
    px, py, pz = rows(form.place)
    x = (
        _column_of_place(px, form.x, begin.x, t, scale),
        _column_of_place(py, form.y, begin.y, t, scale),
        _column_of_place(pz, form.z, begin.z, t, scale),
    )
    c = between(hinge.tangent, hinge.moment)
    r = (
        _column(c[0], t, scale, -axial * bulge[0], stretch),
        _column(c[1], t, scale, -axial * bulge[1], stretch),
        _column(c[2], t, scale, -axial * bulge[2], stretch),
    )
    pulled = _lift(
        plus(form.pull, along, t), add(form.twist, hinge.tendon), t, scale
    )
    force = plus(form.force, normal, t)
    force = plus(
        force, -inv * rod.coupling[k], growth(leg.velocity, leg.before, k)
    )
    loaded = _lift(force, begin.moment, t, scale)
    w = solve(pivot, x[0]), solve(pivot, x[1]), solve(pivot, x[2])
    z = solve(pivot, r[0]), solve(pivot, r[1]), solve(pivot, r[2])
    wc, wo = solve(pivot, pulled), solve(pivot, loaded)
    _store(leg.back[k], w, z, wc, wo)
    form = Form(
        place=less(sum_of(form.place, begin.place), x, w),
        x=scaled(-1.0, dots(z, x[0])),
        y=scaled(-1.0, dots(z, x[1])),
        z=scaled(-1.0, dots(z, x[2])),
        turn=less(_bulged(hinge.tangent, axial, bulge), r, z),
        pull=minus(form.pull, dots(x, wc)),
        twist=minus(scaled(-1.0, hinge.tendon), dots(r, wc)),
        force=minus(add(form.force, begin.force), dots(x, wo)),
        moment=minus(scaled(-1.0, hinge.moment), dots(r, wo)),
    )
    return form, pivot.positive, both - dot4(pulled, wc), one - dot4(pulled, wo)


@helper
def _pivot(form, begin, t, scale, axial, p, normal, inertia, spin):
    """Factors of the 4 x 4 pivot over u = (s, w) of a segment.

    It has four parts: the form beyond the segment, mapped by X = s and Phi = A s + t w; the stretch,
    axial p p^T with the derivative p (4) of l - c; the geometric stiffness of the axial force,
    normal (N), and of the moment on the segment; the inertia of its spin, less the mass times
    1 / (theta h)^2 by which lumped masses exceed linearly moving ones, N/m.

    t: direction; scale: 1 / l, 1/m; axial: N/m.
    """
    P, moment = form.place, begin.moment
    ax, ay, az = _arms((form.x, form.y, form.z), t, scale)
    fx, fy, fz = rows(begin.turn)
    ux, uy, uz = _arms((fx, fy, fz), t, scale)
    wx = _arm((ux[0], uy[0], uz[0]), t, scale)
    wy = _arm((ux[1], uy[1], uz[1]), t, scale)
    wz = _arm((ux[2], uy[2], uz[2]), t, scale)
    ft = (dot(fx, t), dot(fy, t), dot(fz, t))
    turning = _arm(ft, t, scale)
    across = normal * scale
    own = across - inertia
    g = plus(scaled(scale * scale, cross(t, moment)), -0.5 * across, t)
    level = dot(moment, t)
    half = scaled(0.5 * scale, plus(moment, -level, t))
    px, py, pz = axial * p[0], axial * p[1], axial * p[2]
    return factor(
        xx=P.xx + 2.0 * ax[0] + wx[0] + px * p[0] + 2.0 * t[0] * g[0] + own,
        xy=P.xy + ax[1] + ay[0] + wx[1] + px * p[1] + t[0] * g[1] + t[1] * g[0],
        xz=P.xz + ax[2] + az[0] + wx[2] + px * p[2] + t[0] * g[2] + t[2] * g[0],
        xw=dot(form.x, t) + turning[0] + px * p[3] + half[0],
        yy=P.yy + 2.0 * ay[1] + wy[1] + py * p[1] + 2.0 * t[1] * g[1] + own,
        yz=P.yz + ay[2] + az[1] + wy[2] + py * p[2] + t[1] * g[2] + t[2] * g[1],
        yw=dot(form.y, t) + turning[1] + py * p[3] + half[1],
        zz=P.zz + 2.0 * az[2] + wz[2] + pz * p[2] + 2.0 * t[2] * g[2] + own,
        zw=dot(form.z, t) + turning[2] + pz * p[3] + half[2],
        ww=dot(ft, t) + axial * p[3] * p[3] + spin,
    )


@helper
def _column_of_place(p, behind, begin, t, scale):
    """A column of X_k over u, of the form beyond and of the contact at the segment's begin.

    p + behind A + begin A over s, and (behind + begin).t over w.
    """
    s = add(add(p, _arm(behind, t, scale)), _arm(begin, t, scale))
    return (*s, dot(behind, t) + dot(begin, t))


@helper
def _bulged(k, axial, b):
    """K + axial b b^T."""
    return Symmetric(
        xx=k.xx + axial * b[0] * b[0],
        xy=k.xy + axial * b[0] * b[1],
        xz=k.xz + axial * b[0] * b[2],
        yy=k.yy + axial * b[1] * b[1],
        yz=k.yz + axial * b[1] * b[2],
        zz=k.zz + axial * b[2] * b[2],
    )


@helper
def _spun(rod, leg, k, inv, form, hinge):
    """Form over (X_k, Phi_k) of the turn of segment k alone: beyond it, its hinge and its spin.

    The spin's angular momentum changes by I (Omega t - S_n), a moment on the segment over theta h.
    """
    own, inertia = leg.spin[k], rod.spin[k] * inv
    nothing = 0.0 * own
    zero = (nothing, nothing, nothing)
    spun = scaled(own, row(leg.segments.direction, k))
    gained = minus(spun, row(leg.spin_before, k))
    return Form(
        place=Symmetric(nothing, nothing, nothing, nothing, nothing, nothing),
        x=zero,
        y=zero,
        z=zero,
        turn=sum_of(form.turn, hinge.tangent),
        pull=zero,
        twist=zero,
        force=zero,
        moment=plus(add(form.moment, hinge.moment), inertia, gained),
    )


@helper
def _add_node(model, leg, i, inv, form):
    """Add inertia and weight of node i to the form: m (V - V_n) / (theta h) - m g."""
    mass, P = model.rod.mass[i], form.place
    inertia = mass * inv * inv
    change = minus(row(leg.velocity, i), row(leg.before, i))
    force = plus(form.force, mass * inv, change)
    return Form(
        place=Symmetric(
            xx=P.xx + inertia,
            xy=P.xy,
            xz=P.xz,
            yy=P.yy + inertia,
            yz=P.yz,
            zz=P.zz + inertia,
        ),
        x=form.x,
        y=form.y,
        z=form.z,
        turn=form.turn,
        pull=form.pull,
        twist=form.twist,
        force=minus(force, scaled(mass, row(leg.field, 3))),
        moment=form.moment,
    )


@helper
def _arm(r, t, scale):
    """r A for a row r: (r x t) / l, since A s = t x s / l; scale = 1 / l."""
    return scaled(scale, cross(r, t))


@helper
def _arms(rows, t, scale):
    """The rows of M A for the three rows of M."""
    return (
        _arm(rows[0], t, scale),
        _arm(rows[1], t, scale),
        _arm(rows[2], t, scale),
    )


@helper
def _lift(force, moment, t, scale):
    """Right-hand side of u = (s, w) of a force on the segment's end and a moment on the segment."""
    return (*add(force, _arm(moment, t, scale)), dot(t, moment))


@helper
def _column(c, t, scale, share, p):
    """Right-hand side of u of a moment c on the segment, and share times the stretch p (4)."""
    return (*plus(_arm(c, t, scale), share, p), dot(t, c) + share * p[3])


@helper
def _store(back, w, z, wc, wo):
    """Store the rows of -u over (X, Phi, lambda, 1) for the back substitution."""
    for r in range(4):
        for c in range(3):
            back[r, c] = w[c][r]
            back[r, 3 + c] = z[c][r]
        back[r, 6] = wc[r]
        back[r, 7] = wo[r]


@helper
def _write(F, form, both, one):
    """Write the form at the clamp to F (7, 8)."""
    places, turns = rows(form.place), rows(form.turn)
    coupling = (form.x, form.y, form.z)
    for c in range(3):
        for r in range(3):
            F[r, c] = places[r][c]
            F[r, 3 + c] = coupling[r][c]
            F[3 + r, 3 + c] = turns[r][c]
        F[c, 6] = form.pull[c]
        F[3 + c, 6] = form.twist[c]
        F[c, 7] = form.force[c]
        F[3 + c, 7] = form.moment[c]
    F[6, 6] = both
    F[6, 7] = one
    for r in range(1, 7):
        for c in range(r):
            F[r, c] = F[c, r]


@helper
def couple(tendon, leg, inv):
    """Eliminate lambda; writes leg.reduced (6, 7), the form over the displacements of the clamp.

    leg.release (7,) are lambda's factors: lambda = release . (X, Phi, 1).
    """
    F, release, reduced = leg.form, leg.release, leg.reduced
    taut = tendon.stiffness + tendon.damping * inv
    stiffness = where(
        leg.pull[0] > 0.0, like(taut, F[6, 6]), like(0.0, F[6, 6])
    )
    factor = stiffness / (1.0 - stiffness * F[6, 6])
    for c in range(6):
        release[c] = factor * F[6, c]
    release[6] = factor * F[6, 7]
    for r in range(6):
        for c in range(6):
            reduced[r, c] = F[r, c] + F[r, 6] * release[c]
        reduced[r, 6] = F[r, 7] + F[r, 6] * release[6]


@helper
def add_to_torso(leg, matrix, vector):
    """Add a leg's form, mapped by leg.clamp, to the torso's system; in lanes, of all legs."""
    reduced, half, L = leg.reduced, leg.product, leg.clamp
    for r in range(6):
        for c in range(6):
            value = reduced[r, 0] * L[0, c]
            for k in range(1, 6):
                value += reduced[r, k] * L[k, c]
            half[r, c] = value
    for r in range(6):
        value = L[0, r] * reduced[0, 6]
        for k in range(1, 6):
            value += L[k, r] * reduced[k, 6]
        vector[r] += total(value)
        for c in range(r + 1):
            value = L[0, r] * half[0, c]
            for k in range(1, 6):
                value += L[k, r] * half[k, c]
            value = total(value)
            matrix[r, c] += value
            if c < r:
                matrix[c, r] += value


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
    X = (moved[0], moved[1], moved[2])
    turn = (moved[3], moved[4], moved[5])
    most = _move(leg, 0, X, inv, like(0.0, tension))
    for k in range(leg.segments.length.size):
        X, turn, w = follow(leg, k, X, turn, tension)
        leg.spin[k] += w * inv
        most = _move(leg, k + 1, X, inv, most)
    return largest(most) * inv * inv


@helper
def _move(leg, i, X, inv, most):
    """Add a displacement to the velocity of node i; the largest squared displacement so far."""
    put(leg.velocity, i, plus(row(leg.velocity, i), inv, X))
    return max(most, dot(X, X))


@helper
def follow(leg, k, X, turn, tension):
    """Displacement of a segment's end, its rotation and its turn w, from those at its begin.

    X (3), m, and turn (3), rad: displacement of node k and rotation of the segment before it;
    tension: change lambda, N.
    """
    t = row(leg.segments.direction, k)
    s = (
        _entry(leg.back, k, 0, X, turn, tension),
        _entry(leg.back, k, 1, X, turn, tension),
        _entry(leg.back, k, 2, X, turn, tension),
    )
    w = _entry(leg.back, k, 3, X, turn, tension)
    turned = plus(scaled(leg.segments.per_length[k], cross(t, s)), w, t)
    return add(X, s), turned, w


@helper
def _entry(back, k, r, X, turn, tension):
    """Entry r of u = (s, w) of segment k."""
    value = back[k, r, 7] + back[k, r, 6] * tension
    value += back[k, r, 0] * X[0] + back[k, r, 1] * X[1] + back[k, r, 2] * X[2]
    value += back[k, r, 3] * turn[0]
    value += back[k, r, 4] * turn[1]
    value += back[k, r, 5] * turn[2]
    return -value
