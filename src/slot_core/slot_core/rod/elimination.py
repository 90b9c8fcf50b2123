"""Elimination of the rod's unknowns from its base to its tip, and the substitution.

The unknowns of Newton's method are the turn of the base's section (3) and an unused entry, then of
every node its displacement (3) and the turn w of the segment behind it about itself, which is
unused at the tip's node, last the turn of the tip's section (3): x has 4 N + 7 entries. The hinge at
node k depends on x[4 k : 4 k + 11]. Row i of work.factor (4 N + 7, 11) holds the columns from i on of
the tangent, whose upper half is used; row by row, it is eliminated in place.
The unsymmetric terms of a follower force and of a dead moment enter the last 7 x 7 block alone. A
negative pivot means that the tangent is not positive definite: the number of negative pivots is the
number of unstable directions.

Tangent and gradient are assembled hinge by hinge. Over the difference s of a segment's two
displacements and w, its rotation is

    Phi = t x s / l + t (w + z.s),      z = t x a / (l (1 + a.t)),

and a moment m on the segment acts on (s, w) with (m x t / l + m.t z, m.t). Here a is the direction
from which the director is carried to t in this step; z is 0 in statics. An end's section has Phi
itself as s.

The axial force is an independent unknown and enters the geometric stiffness (mixed integration
points; Magisano, Leonetti, Garcea 2017). The solution is the same, but Newton's method converges in
fewer iterations and from farther away where stretch is much stiffer than bending.

The antisymmetric part of a segment's block is left out: it comes from spins not being coordinates
and vanishes in equilibrium. That of the tip's section is not, because a dead moment has no
potential.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math

from slot_core.arrays import named
from slot_core.compiled import helper
from slot_core.dynamics.algebra import (
    add,
    combined,
    cross,
    dot,
    minus,
    plus,
    put,
    row,
    scaled,
)
from slot_core.dynamics.contact import normal_force
from slot_core.dynamics.spatial.elimination import sum_of
from slot_core.dynamics.spatial.hinge import (
    Hinge,
    bend,
    between,
    derivative,
    rows,
    turned_tangent,
)
from slot_core.dynamics.spatial.strain import frame_before, growth
from slot_core.matrices import inner

Lever = named("Lever", "t scale keep z", __name__)
"""How a moment acts on (s, w): (scale m x t + keep m + m.t z, m.t)."""
ZERO = (0.0, 0.0, 0.0)
SECTION = Lever(ZERO, 0.0, 1.0, ZERO)  # of an end
WIDTH = 11  # number of unknowns of a hinge


@helper
def lever_of(work, k):
    """Lever of segment k, whose director is carried on from the direction a = work.begin[k].

    Behind the last hinge that of the tip's section.
    """
    if k == work.normal.size - 1:
        return SECTION
    s, a = work.segments, row(work.begin, k)
    t, scale = row(s.direction, k), s.per_length[k]
    z = scaled(scale / (1.0 + dot(a, t)), cross(t, a))
    return Lever(t, scale, 0.0, z)


@helper
def acting(lever, m):
    """The four components over (s, w) of a moment m."""
    w = dot(m, lever.t)
    s = combined(lever.scale, cross(m, lever.t), lever.keep, m, w, lever.z)
    return (*s, w)


@helper
def hinge(mesh, work, k, inv, before, behind):
    """Write the form of the hinge at node k over (s, w) of the segments before and behind it.

    inv is 1 / (theta h), and 0 in statics; before, behind: levers of both. Writes work.form (8, 9),
    the tangent | negative gradient, work.stretch (8,), and the hinge's moments, N m.
    """
    s, rod, tension = work.segments, mesh.rod, work.tension[k]
    beta = rod.damping_time
    viscous = 1.0 + beta * inv
    normal = rod.axial[k] * (s.extension[k] + beta * s.extension_rate[k])
    normal += work.carried[k]
    base = frame_before(s, k, work.stage_frame[0])
    h = bend(rod, s, k, base, viscous, tension, mesh.none, 0.0)
    for i in range(work.pull.shape[0]):
        h = _pulled(mesh, work, i, k, base, h, before, behind)
    m = plus(h.moment, normal - tension, h.bulge)
    m = minus(m, _refined(mesh, s, k, base))
    work.normal[k] = normal
    put(work.moment, k, h.moment)
    put(work.residual, k, m)
    Q, tangent = work.form, rows(h.tangent)
    _product(Q[:4, :4], tangent, before, before, True)
    _product(Q[:4, 4:8], between(h.tangent, h.moment), before, behind, False)
    _product(Q[4:8, 4:8], tangent, behind, behind, True)
    _gradient(Q, m, normal, before, behind)
    axial = viscous * rod.axial[k]
    _stretch(work.stretch[k], Q, h.bulge, before, behind, axial)


@helper
def _cable(mesh, s, i, k):
    """Length (m) of tendon i at hinge k and its derivative by psi (`model.RodTendon`)."""
    p, rise = mesh.cables.offset[i, k], mesh.cables.rise[i, k]
    ahead = mesh.refinement.extent[k] + s.turn[k] * p[1] - s.side[k] * p[0]
    right, down = rise[0] - s.twist[k] * p[1], rise[1] + s.twist[k] * p[0]
    length = math.sqrt(ahead * ahead + right * right + down * down)
    slope = (down * p[0] - right * p[1], ahead * p[1], -ahead * p[0])
    return length, scaled(1.0 / length, slope)


@helper
def tighten(mesh, work, loads):
    """Write pull, stiffness and length of the tendons, and the axial force by them."""
    s, along = work.segments, mesh.cables.along
    work.carried[:] = 0.0
    for i in range(work.pull.shape[0]):
        given, rest, stiffness = row(loads.tendon, i)
        length = 0.0
        for k in range(work.normal.size):
            part, _ = _cable(mesh, s, i, k)
            length += part + along[i, k] * s.extension[k]
        pull = max(0.0, given + stiffness * (length - rest))
        put(work.pull, i, (pull, stiffness * (pull > 0.0), length))
        for k in range(work.normal.size):
            work.carried[k] += pull * along[i, k]


@helper
def _pulled(mesh, work, i, k, base, h, before, behind):
    """The hinge with tendon i: moment T dl/dpsi, tangent T d2l/dpsi2; writes work.reach[i, k].

    In fixed axes d2l/dpsi2 = (q q^T + p.p vt vt^T - g g^T) / l with g = dl/dpsi, q = p_b vd - p_d vb.
    """
    s, p = work.segments, mesh.cables.offset[i, k]
    x, y, z = s.twist[k], s.turn[k], s.side[k]
    vt, vd, vb = derivative(base, x, y, z, s.curl[k])
    length, slope = _cable(mesh, s, i, k)
    g = combined(slope[0], vt, slope[1], vd, slope[2], vb)
    q = plus(scaled(p[1], vd), -p[0], vb)
    firm = work.pull[i, 0] / length
    around = scaled(p[0] * p[0] + p[1] * p[1], vt)
    stiffness = (
        scaled(firm, combined(q[0], q, around[0], vt, -g[0], g)),
        scaled(firm, combined(q[1], q, around[1], vt, -g[1], g)),
        scaled(firm, combined(q[2], q, around[2], vt, -g[2], g)),
    )
    moment = scaled(work.pull[i, 0], g)
    psi = combined(x, base[0], y, base[1], z, base[2])
    own = turned_tangent(stiffness, psi, moment)
    a, b = acting(before, g), acting(behind, g)
    for c in range(4):
        work.reach[i, k, c], work.reach[i, k, 4 + c] = -a[c], b[c]
    return Hinge(add(h.moment, moment), sum_of(h.tangent, own), g, h.bulge)


@helper
def lengthen(mesh, work, i):
    """Write the derivative of the length of tendon i to work.gradient[i]; after `assemble`."""
    g, q = work.gradient[i], work.form[:, 8]
    g[:] = 0.0
    for k in range(work.normal.size):
        for c in range(8):
            along = mesh.cables.along[i, k] * work.stretch[k, c]
            q[c] = work.reach[i, k, c] + along
        scatter(g[4 * k : 4 * k + WIDTH], q, signs(work, k))


@helper
def couple(mesh, work):
    """Write the response to each taut tendon of a given length, by the factorised tangent.

    With the gradient g and the stiffness k of a tendon the tangent is A + k g g^T (Sherman and
    Morrison). Returns the change of the number of negative pivots, 0 or less.
    """
    negative = 0
    for i in range(work.pull.shape[0]):
        if work.pull[i, 1] > 0.0:
            lengthen(mesh, work, i)
            x, g = work.response[i], work.gradient[i]
            for c in range(x.size):
                x[c] = g[c] * mesh.free[c]
            _forward(work, x)
            _back(work, x)
            _restrain(work, x, i)
            work.yielding[i] = 1.0 / work.pull[i, 1] + inner(g, x)
            negative -= work.yielding[i] < 0.0
    return negative


@helper
def _restrain(work, x, count):
    """Correct a solution x (4 N + 7,) for the first `count` tendons."""
    for i in range(count):
        if work.pull[i, 1] > 0.0:
            share = inner(work.gradient[i], x) / work.yielding[i]
            for c in range(x.size):
                x[c] -= share * work.response[i, c]


@helper
def touch(mesh, work, i, inv):
    """Force of the walls on node i, N; adds their tangent."""
    walls, force, u = mesh.walls, ZERO, row(work.speed, i)
    at = 4 * i + 4
    for j in range(walls.level.size):
        n = row(walls.normal, j)
        gap, vn = dot(n, row(work.stage, i)) - walls.level[j], dot(n, u)
        if gap < 0.0:
            stiffness, damping = walls.stiffness[j, i], walls.damping[j, i]
            normal, v = (
                normal_force(stiffness, damping, gap, vn),
                plus(u, -vn, n),
            )
            slip = math.sqrt(dot(v, v) + walls.creep[j] ** 2)
            drag = walls.friction[j] * normal / slip
            force = plus(plus(force, normal, n), -drag, v)
            firm = (normal > 0.0) * (stiffness + damping * inv - drag * inv)
            for c in range(3):
                work.factor[at + c, 0] += drag * inv
                for e in range(c, 3):
                    work.factor[at + c, e - c] += firm * n[c] * n[e]
    return force


@helper
def _refined(mesh, s, k, base):
    """Moment of the hinge's correction `strain.py`, B delta mapped as in `strain.py`."""
    t, d, b = base
    psi = (s.twist[k], s.turn[k], s.side[k])
    mu = row(mesh.refinement.delta, k)
    once = cross(psi, mu)
    v = plus(plus(mu, 0.5, once), s.curl[k], cross(psi, once))
    return combined(v[0], t, v[1], d, v[2], b)


@helper
def _product(out, r, left, right, upper):
    """out (4, 4) = P_left^T R P_right of a matrix R with the rows r; its upper half, or all."""
    a, b, c = acting(right, r[0]), acting(right, r[1]), acting(right, r[2])
    for j in range(4):
        column = acting(left, (a[j], b[j], c[j]))
        for i in range(j + 1 if upper else 4):
            out[i, j] = column[i]


@helper
def _gradient(Q, m, normal, before, behind):
    """Negative gradient of the hinge and of the segment behind it."""
    a, b = acting(before, m), acting(behind, m)
    for i in range(4):
        Q[i, 8] = a[i]
        Q[4 + i, 8] = -b[i]
    for i in range(3):
        Q[4 + i, 8] -= normal * behind.t[i]


@helper
def _stretch(g, Q, bulge, before, behind, axial):
    """Add the axial stiffness of the segment behind the hinge; g (8,): derivative of l - c."""
    a, b = acting(before, bulge), acting(behind, bulge)
    for i in range(4):
        g[i] = -a[i]
        g[4 + i] = b[i]
    for i in range(3):
        g[4 + i] += behind.t[i]
    for i in range(8):
        share = axial * g[i]
        for j in range(i, 8):
            Q[i, j] += share * g[j]


@helper
def own(mesh, work, k, inv, lever):
    """Add the terms of segment k alone to the form, as the segment before a hinge.

    Its geometric stiffness, its spin, and the rest of its inertia (`dynamics/rod.py`). Both
    hinges must have their moments.
    """
    Q, t, scale = work.form, lever.t, work.segments.per_length[k]
    inertia, mu = mesh.rod.spin[k] * inv, mesh.rod.coupling[k] * inv
    gained = minus(scaled(work.spin[k], t), row(work.swirl, k))
    turning = scaled(inertia, gained)
    m = minus(row(work.moment, k), row(work.moment, k + 1))
    m = add(m, turning)
    across = work.tension[k] * scale
    square, half = scale * scale, 0.5 * scale
    q, mt = cross(t, m), dot(m, t)
    pull, lag = acting(lever, turning), growth(work.speed, work.before, k)
    for i in range(3):
        g = square * q[i] - across * t[i]
        for j in range(i, 3):
            Q[i, j] += t[j] * g + square * q[j] * t[i]
        Q[i, i] += across - mu * inv
        Q[i, 3] += half * (m[i] - mt * t[i])
        Q[i, 8] += mu * lag[i] - pull[i]
    Q[3, 3] += inertia * inv
    Q[3, 8] -= pull[3]


@helper
def signs(work, k):
    """Factors of displacements in the differences s before and behind the hinge at node k.

    Before it sign x_{k-1} + share x_k, behind it x_{k+1} - keep x_k; the turn of an end's section
    stands for the displacement beyond the end, and for s.
    """
    return 1.0 - 2.0 * (k > 0), 1.0 * (k > 0), 1.0 * (k < work.normal.size - 1)


@helper
def spread(work, k):
    """Add the form of the hinge at node k over its unknowns to the tangent."""
    A, Q, at = work.factor, work.form, 4 * k
    sign, share, keep = signs(work, k)
    for i in range(3):
        for j in range(i, 3):
            aa, ab, bb = Q[i, j], Q[i, 4 + j], Q[4 + i, 4 + j]
            both = share * (aa - keep * (ab + Q[j, 4 + i])) + keep * bb
            A[at + i, j - i] += aa
            A[at + 4 + i, j - i] += both
            A[at + 8 + i, j - i] += bb
        for j in range(3):
            aa, ab, bb = (
                Q[min(i, j), max(i, j)],
                Q[i, 4 + j],
                Q[4 + min(i, j), 4 + max(i, j)],
            )
            A[at + i, 4 + j - i] += sign * (share * aa - keep * ab)
            A[at + i, 8 + j - i] += sign * ab
            A[at + 4 + i, 4 + j - i] += share * ab - keep * bb
        A[at + i, 3 - i] += sign * Q[i, 3]
        A[at + i, 7 - i] += sign * Q[i, 7]
        A[at + 3, 1 + i] += share * Q[i, 3] - keep * Q[3, 4 + i]
        A[at + 3, 5 + i] += Q[3, 4 + i]
        A[at + 4 + i, 3 - i] += share * Q[i, 7] - keep * Q[4 + i, 7]
        A[at + 7, 1 + i] += Q[4 + i, 7]
    A[at + 3, 0] += Q[3, 3]
    A[at + 3, 4] += Q[3, 7]
    A[at + 7, 0] += Q[7, 7]


@helper
def scatter(x, q, factors):
    """Add a derivative q (8,) over (s, w) before and behind a node to x (11,), its hinge's unknowns."""
    sign, share, keep = factors
    for i in range(3):
        x[i] += sign * q[i]
        x[4 + i] += share * q[i] - keep * q[4 + i]
        x[8 + i] += q[4 + i]
    x[3] += q[3]
    x[7] += q[7]


@helper
def assemble(mesh, work, loads, inv):
    """Write the tangent, and the negative gradient to work.change, at the strains of the iterate.

    loads: as in `statics.RodLoads`. A hinge's form is complete with the terms of the segment before
    it, which need both its hinges.
    """
    x, count, ahead = work.change, work.normal.size, SECTION
    tighten(mesh, work, loads)
    work.factor[:] = 0.0
    x[:] = 0.0
    for k in range(count):
        here, ahead = ahead, lever_of(work, k)
        hinge(mesh, work, k, inv, here, ahead)
        if k > 0:
            own(mesh, work, k - 1, inv, here)
        spread(work, k)
        scatter(x[4 * k : 4 * k + WIDTH], work.form[:, 8], signs(work, k))
        node(mesh, work, loads.dead, k, inv)
    for c in range(3):
        x[4 * count + c] += follower_force(work, loads)[c]
        x[4 * count + 4 + c] += loads.moment[c]


@helper
def node(mesh, work, dead, i, inv):
    """Add inertia, dead load (N, 3), N, and contact of node i."""
    at, mass = 4 * i + 4, mesh.rod.mass[i] * inv
    pushed = touch(mesh, work, i, inv)
    for c in range(3):
        work.factor[at + c, 0] += mass * inv
        force = dead[i, c] - mass * (work.speed[i, c] - work.before[i, c])
        work.change[at + c] += force + pushed[c]


@helper
def follower_force(work, loads):
    """The follower force in fixed axes, N."""
    frame, f = work.stage_frame[1], loads.follower
    return combined(
        f[0], row(frame, 0), -f[1], row(frame, 1), -f[2], row(frame, 2)
    )


@helper
def turn_tip(mesh, work, loads, F):
    """Add the unsymmetric terms of the tip to the last block F (7, 7), but those of held unknowns.

    The force turns by Phi x f. The hinge's moment m has the antisymmetric tangent Phi x m / 2.
    """
    f, m = follower_force(work, loads), row(work.moment, work.normal.size - 1)
    free = mesh.free[-7:]
    for i in range(3):
        e = (1.0 * (i == 0), 1.0 * (i == 1), 1.0 * (i == 2))
        turn, half = cross(e, f), cross(e, m)
        for j in range(3):
            F[j, 4 + i] -= free[j] * free[4 + i] * turn[j]
            F[4 + j, 4 + i] += free[4 + j] * free[4 + i] * 0.5 * half[j]


@helper
def hold(mesh, work):
    """Replace the equations of the unknowns that are held or unused by x = work.gap (4 N + 7,)."""
    A, x, gap = work.factor, work.change, work.gap
    for u in mesh.fixed:
        for c in range(1, WIDTH):
            if u >= c:
                x[u - c] -= A[u - c, c] * gap[u]
                A[u - c, c] = 0.0
            if u + c < x.size:
                x[u + c] -= A[u, c] * gap[u]
            A[u, c] = 0.0
        A[u, 0] = 1.0
        x[u] = gap[u]


@helper
def eliminate(mesh, work, loads, inv, shift):
    """Factorise the tangent of `assemble`, and eliminate its gradient; the number of negative pivots.

    shift: times the metric, added.
    """
    A, x, negative = work.factor, work.change, 0
    assemble(mesh, work, loads, inv)
    if shift > 0.0:
        for i in range(x.size):
            A[i, 0] += shift * mesh.metric[i]
    hold(mesh, work)
    for k in range(work.normal.size):
        for j in range(4):
            i = 4 * k + j
            negative += A[i, 0] < 0.0
            A[i, 0] = 1.0 / A[i, 0]
            for r in range(1, WIDTH - j):
                ratio = A[i, r] * A[i, 0]
                x[i + r] -= ratio * x[i]
                for c in range(r, WIDTH - j):
                    A[i + r, c - r] -= ratio * A[i, c]
    return negative + _last(mesh, work, loads) + couple(mesh, work)


@helper
def _last(mesh, work, loads):
    """Factorise the block of the tip's node and section, with its unsymmetric terms."""
    F, at, negative = work.last, 4 * work.normal.size, 0
    for i in range(7):
        for j in range(i, 7):
            F[i, j] = F[j, i] = work.factor[at + i, j - i]
    turn_tip(mesh, work, loads, F)
    for i in range(7):
        negative += F[i, i] < 0.0
        F[i, i] = 1.0 / F[i, i]
        for r in range(i + 1, 7):
            F[r, i] *= F[i, i]
            for c in range(i + 1, 7):
                F[r, c] -= F[r, i] * F[i, c]
    return negative


@helper
def _forward(work, x):
    """Eliminate a right-hand side x (4 N + 7,) as the tangent was."""
    A = work.factor
    for k in range(work.normal.size):
        for j in range(4):
            i = 4 * k + j
            value = x[i] * A[i, 0]
            for c in range(1, WIDTH - j):
                x[i + c] -= A[i, c] * value


@helper
def _back(work, x):
    """Replace a right-hand side x (4 N + 7,), eliminated, by the solution; held entries stay."""
    A, F, last = work.factor, work.last, x[-7:]
    for i in range(7):
        for r in range(i + 1, 7):
            last[r] -= F[r, i] * last[i]
    for i in range(6, -1, -1):
        for c in range(i + 1, 7):
            last[i] -= F[i, c] * last[c]
        last[i] *= F[i, i]
    for k in range(work.normal.size - 1, -1, -1):
        for j in range(3, -1, -1):
            i = 4 * k + j
            value = x[i]
            # the newest entry last: it is available last
            for c in range(WIDTH - 1 - j, 0, -1):
                value -= A[i, c] * x[i + c]
            x[i] = value * A[i, 0]


@helper
def substitute(mesh, work):
    """Write the Newton increment to work.change; returns its largest entry, rad or rod lengths."""
    _back(work, work.change)
    _restrain(work, work.change, work.pull.shape[0])
    return _largest(mesh, work)


@helper
def _largest(mesh, work):
    """Largest entry: displacement over the length, turn of a segment or section; NaN if any is."""
    x, s, count = work.change, work.segments, work.normal.size
    largest, scale = 0.0, 1.0 / mesh.length
    for k in range(count):
        for c in range(3):
            at = 4 * k + 4 + c
            size = abs(x[at]) * scale
            if k < count - 1:
                size = max(size, abs(x[at + 4] - x[at]) * s.per_length[k])
            size = max(size, abs(x[c]), abs(x[4 * count + 4 + c]))
            if math.isnan(size + x[at]):
                return math.nan
            largest = max(largest, size)
        largest = max(largest, abs(x[4 * k + 3]))
    return largest


@helper
def pull(mesh, work, inv):
    """Update the independent axial forces by the Newton increment."""
    x, viscous = work.change, 1.0 + mesh.rod.damping_time * inv
    for k in range(work.normal.size - 1):
        g, at = work.stretch[k], 4 * k
        value = g[3] * x[at + 3] + g[7] * x[at + 7]
        for i in range(3):
            s = x[at + 4 + i] - x[at + i] if k > 0 else x[i]
            value += g[i] * s + g[4 + i] * (x[at + 8 + i] - x[at + 4 + i])
        work.tension[k] = work.normal[k] + mesh.rod.axial[k] * viscous * value
