"""Elimination of the rod's unknowns from its base to its tip, and the substitution.

Four unknowns are eliminated with each hinge. The unsymmetric terms of a follower force and of a
dead moment enter the last 6 x 6 block alone. A negative pivot means that the tangent is not
positive definite: the number of negative pivots is the number of unstable directions.

Tangent and gradient are assembled hinge by hinge. The unknowns of Newton's method are
the turn of the base's section (3, and an unused entry), then of every node
its displacement (3) and the turn w of the segment behind it about itself, last the displacement of
the tip's node, the turn of the tip's section (3) and an unused entry: x has 4 N + 7 entries. The hinge
at node k depends on x[4 k : 4 k + 11]. Over the difference s of a segment's two displacements and
w, its rotation is

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
from typing import NamedTuple

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


class Lever(NamedTuple):
    """How a moment acts on (s, w): (scale m x t + keep m + m.t z, m.t)."""

    t: tuple[float, float, float]
    scale: float
    keep: float
    z: tuple[float, float, float]


ZERO = (0.0, 0.0, 0.0)
SECTION = Lever((0.0, 0.0, 0.0), 0.0, 1.0, ZERO)  # of an end


@helper
def segment(work, k):
    """Lever of segment k, whose director is carried on from the direction a = work.begin[k]."""
    s, a = work.segments, row(work.begin, k)
    t, scale = row(s.direction, k), s.per_length[k]
    return Lever(
        t, scale, 0.0, plus(ZERO, scale / (1.0 + dot(a, t)), cross(t, a))
    )


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
    s, beta, tension = work.segments, mesh.damping_time, work.tension[k]
    viscous = 1.0 + beta * inv
    normal = mesh.axial[k] * (s.extension[k] + beta * s.extension_rate[k])
    normal += work.carried[k]
    base = frame_before(s, k, work.stage_frame[0])
    h = bend(mesh, s, k, base, viscous, tension, mesh.none, 0.0)
    for i in range(work.pull.shape[0]):
        h = _pulled(mesh, work, i, k, base, h, before, behind)
    m = plus(h.moment, normal - tension, h.bulge)
    m = minus(m, _refined(mesh, s, k, base))
    work.normal[k] = normal
    put(work.moment, k, h.moment)
    put(work.residual, k, m)
    Q = work.form
    _stiffness(Q, h, before, behind)
    _gradient(Q, m, normal, before, behind)
    axial = viscous * mesh.axial[k]
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
    g, Q, last = work.gradient[i], work.form, work.normal.size - 1
    g[:] = 0.0
    for k in range(last + 1):
        for c in range(8):
            along = mesh.cables.along[i, k] * work.stretch[k, c]
            Q[c, 8] = work.reach[i, k, c] + along
        if k == last:
            spread_last(work.block, Q)
        else:
            spread(work.block, Q, 1.0 - 2.0 * (k > 0), 1.0 * (k > 0))
        for c in range(11):
            g[4 * k + c] += work.block[c, 11]


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
def _forward(work, x):
    """Eliminate a right-hand side x (4 N + 7,) as the tangent was; held entries are 0."""
    F, at = work.last, 4 * work.normal.size
    for k in range(work.normal.size):
        for i in range(4):
            value = x[4 * k + i] * work.factor[k, i, i]
            for r in range(i + 1, 11):
                x[4 * k + r] -= work.factor[k, i, r] * value
    for i in range(6):
        value = x[at + i] * F[i, i]
        for r in range(i + 1, 6):
            x[at + r] -= F[r, i] * value


@helper
def touch(mesh, work, i, inv, F, at):
    """Force of the walls on node i, N; adds their tangent to the diagonal block of F at `at`."""
    walls, force, u = mesh.walls, ZERO, row(work.speed, i)
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
                F[at + c, at + c] += drag * inv
                for e in range(3):
                    F[at + c, at + e] += firm * n[c] * n[e]
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
def _stiffness(Q, h, before, behind):
    """Tangent of the hinge: K on both sides, [m] / 2 - K between them."""
    own = rows(h.tangent)
    _product(Q[:4, :4], own, before, before)
    _product(Q[:4, 4:8], between(h.tangent, h.moment), before, behind)
    _product(Q[4:8, 4:8], own, behind, behind)


@helper
def _product(out, r, left, right):
    """out (4, 4) = P_left^T R P_right of a matrix R with the rows r."""
    a, b, c = acting(right, r[0]), acting(right, r[1]), acting(right, r[2])
    for j in range(4):
        column = acting(left, (a[j], b[j], c[j]))
        for i in range(4):
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
        for j in range(8):
            Q[i, j] += share * g[j]


@helper
def own(mesh, work, k, inv, lever):
    """Add the terms of segment k alone to the form, as the segment before a hinge.

    Its geometric stiffness, its spin, and the rest of its inertia (`dynamics/rod.py`). Both
    hinges must have their moments.
    """
    Q, t, scale = work.form, lever.t, work.segments.per_length[k]
    inertia, mu = mesh.spin[k] * inv, mesh.coupling[k] * inv
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
        for j in range(3):
            Q[i, j] += t[j] * g + square * q[j] * t[i]
        Q[i, i] += across - mu * inv
        Q[i, 3] += half * (m[i] - mt * t[i])
        Q[i, 8] += mu * lag[i] - pull[i]
    Q[3, 3] += inertia * inv
    Q[3, 8] -= pull[3]


@helper
def spread(F, Q, sign, share):
    """Write a hinge's form to F (11, 12) over its unknowns; the upper half.

    sign, share: -1 and 1, since s before the hinge is share times the node's displacement plus
    sign times the displacement of the node before; +1 and 0 for the base's section.
    """
    for i in range(3):
        for j in range(3):
            aa, ab, bb = Q[i, j], Q[i, 4 + j], Q[4 + i, 4 + j]
            F[i, j] = aa
            F[i, 4 + j] = sign * (share * aa - ab)
            F[i, 8 + j] = sign * ab
            F[4 + i, 4 + j] = share * (aa - ab - Q[j, 4 + i]) + bb
            F[4 + i, 8 + j] = share * ab - bb
            F[8 + i, 8 + j] = bb
        F[i, 3] = sign * Q[i, 3]
        F[i, 7] = sign * Q[i, 7]
        F[3, 4 + i] = share * Q[i, 3] - Q[3, 4 + i]
        F[3, 8 + i] = Q[3, 4 + i]
        F[4 + i, 7] = share * Q[i, 7] - Q[4 + i, 7]
        F[7, 8 + i] = Q[4 + i, 7]
        F[i, 11] = sign * Q[i, 8]
        F[4 + i, 11] = share * Q[i, 8] - Q[4 + i, 8]
        F[8 + i, 11] = Q[4 + i, 8]
    F[3, 3] = Q[3, 3] + 1.0 - share
    F[3, 7] = Q[3, 7]
    F[7, 7] = Q[7, 7]
    F[3, 11] = Q[3, 8]
    F[7, 11] = Q[7, 8]


@helper
def spread_last(F, Q):
    """The same for the tip's hinge."""
    for i in range(3):
        for j in range(3):
            aa, ab = Q[i, j], Q[i, 4 + j]
            F[i, j] = aa
            F[i, 4 + j] = -aa
            F[4 + i, 4 + j] = aa
            F[i, 7 + j] = -ab
            F[4 + i, 7 + j] = ab
            F[7 + i, 7 + j] = Q[4 + i, 4 + j]
        F[i, 3] = -Q[i, 3]
        F[3, 4 + i] = Q[i, 3]
        F[3, 7 + i] = Q[3, 4 + i]
        F[i, 10] = F[4 + i, 10] = F[7 + i, 10] = 0.0
        F[i, 11] = -Q[i, 8]
        F[4 + i, 11] = Q[i, 8]
        F[7 + i, 11] = Q[4 + i, 8]
    F[3, 3] = Q[3, 3]
    F[3, 11] = Q[3, 8]
    F[3, 10] = F[10, 11] = 0.0
    F[10, 10] = 1.0


@helper
def assemble(mesh, work, inv):
    """Write the blocks of all hinges to work.factor (N, 11, 12), at the strains of the iterate.

    A hinge's form is complete with the terms of the segment before it, which need both its hinges.
    """
    F, Q, last = work.factor, work.form, work.normal.size - 1
    ahead = segment(work, 0)
    hinge(mesh, work, 0, inv, SECTION, ahead)
    spread(F[0], Q, 1.0, 0.0)
    for k in range(1, last):
        here, ahead = ahead, segment(work, k)
        hinge(mesh, work, k, inv, here, ahead)
        own(mesh, work, k - 1, inv, here)
        spread(F[k], Q, -1.0, 1.0)
    hinge(mesh, work, last, inv, ahead, SECTION)
    own(mesh, work, last - 1, inv, ahead)
    spread_last(F[last], Q)


@helper
def node(mesh, work, dead, i, inv, F, at):
    """Add inertia, dead load and contact of node i to the diagonal and the last column of F.

    dead (N, 3): forces, N; at: row of F of the node's displacement along x.
    """
    mass = mesh.mass[i] * inv
    pushed = touch(mesh, work, i, inv, F, at)
    for c in range(3):
        F[at + c, at + c] += mass * inv
        force = dead[i, c] - mass * (work.speed[i, c] - work.before[i, c])
        F[at + c, F.shape[1] - 1] += force + pushed[c]


@helper
def prescribe(held, gap, F, rows):
    """Replace the equations of the held unknowns among the first of F by x = gap.

    held (n,): which of the first n are held; rows: number of equations of F.
    """
    for c in range(held.size):
        if held[c]:
            for i in range(rows):
                # 0 but in the last block, which is full
                F[i, F.shape[1] - 1] -= F[i, c] * gap[c]
                F[i, c] = 0.0
            for j in range(F.shape[1] - 1):
                F[c, j] = 0.0
            F[c, c] = 1.0
            F[c, F.shape[1] - 1] = gap[c]


@helper
def eliminate(mesh, work, loads, inv, shift):
    """Factorise the tangent; returns the number of negative pivots.

    loads: as in `statics.RodLoads`; shift: times the metric, added.
    """
    negative, count = 0, work.normal.size
    tighten(mesh, work, loads)
    assemble(mesh, work, inv)
    for k in range(count):
        F = work.factor[k]
        if k > 0:
            _carry(F, work.factor[k - 1])
            node(mesh, work, loads[0], k - 1, inv, F, 0)
        if shift > 0.0:
            for i in range(4):
                F[i, i] += shift * mesh.metric[4 * k + i]
        if k == 0:
            prescribe(mesh.held[0, 3:], work.gap[0, 3:], F, 11)
        elif k == 1:
            prescribe(mesh.held[0, :3], work.gap[0, :3], F, 11)
        negative += reduce(F)
    negative += _last(mesh, work, loads, inv, shift)
    return negative + couple(mesh, work)


@helper
def _carry(F, before):
    """Add the remainder of the hinge before."""
    for i in range(7):
        for j in range(i, 7):
            F[i, j] += before[4 + i, 4 + j]
        F[i, 11] += before[4 + i, 11]


@helper
def reduce(F):
    """Eliminate the first four unknowns of F (11, 12); returns the number of negative pivots."""
    negative = 0
    for i in range(4):
        negative += F[i, i] < 0.0
        pivot = 1.0 / F[i, i]
        for r in range(i + 1, 11):
            ratio = F[i, r] * pivot
            for c in range(r, 12):
                F[r, c] -= ratio * F[i, c]
        F[i, i] = pivot
    return negative


@helper
def _last(mesh, work, loads, inv, shift):
    """Factorise the block of the tip's node and section, with its unsymmetric terms."""
    F, before, tip = work.last, work.factor[-1], work.normal.size - 1
    for i in range(6):
        F[i, 6] = before[4 + i, 11]
        for j in range(6):
            F[i, j] = before[4 + min(i, j), 4 + max(i, j)]
        if shift > 0.0:
            F[i, i] += shift * mesh.metric[4 * tip + 4 + i]
    node(mesh, work, loads[0], tip, inv, F, 0)
    load_tip(work, loads, F)
    prescribe(mesh.held[1], work.gap[1], F, 6)
    negative = 0
    for i in range(6):
        negative += F[i, i] < 0.0
        F[i, i] = 1.0 / F[i, i]
        for r in range(i + 1, 6):
            ratio = F[r, i] * F[i, i]
            for k in range(i + 1, 7):
                F[r, k] -= ratio * F[i, k]
    return negative


@helper
def follower_force(frame, f):
    """Force f (3,) along the axes of a section with the frame (3, 3), in fixed axes."""
    t, d, b = row(frame, 0), row(frame, 1), row(frame, 2)
    return combined(f[0], t, -f[1], d, -f[2], b)


@helper
def load_tip(work, loads, F):
    """Add moment and follower force of the tip, and the unsymmetric terms, to F (6, 7).

    The force turns by Phi x f. The hinge's moment m has the antisymmetric tangent Phi x m / 2.
    """
    f = follower_force(work.stage_frame[1], loads[2])
    m = row(work.moment, work.normal.size - 1)
    for i in range(3):
        e = (1.0 * (i == 0), 1.0 * (i == 1), 1.0 * (i == 2))
        turn, half = cross(e, f), cross(e, m)
        for j in range(3):
            F[j, 3 + i] -= turn[j]
            F[3 + j, 3 + i] += 0.5 * half[j]
        F[i, 6] += f[i]
        F[3 + i, 6] += loads[1][i]


@helper
def substitute(mesh, work):
    """Write the Newton increment to work.change; returns its largest entry, rad or rod lengths."""
    x, count = work.change, work.normal.size
    for i in range(6):
        x[4 * count + i] = work.last[i, 6]
    for k in range(count):
        for i in range(4):
            x[4 * k + i] = work.factor[k, i, 11]
    _back(work, x)
    _restrain(work, x, work.pull.shape[0])
    return _largest(mesh, work)


@helper
def _back(work, x):
    """Replace a right-hand side x (4 N + 7,), eliminated, by the solution."""
    F, count = work.last, work.normal.size
    at = 4 * count
    x[at + 6] = 0.0
    for i in range(5, -1, -1):
        value = x[at + i]
        for j in range(i + 1, 6):
            value -= F[i, j] * x[at + j]
        x[at + i] = value * F[i, i]
    for k in range(count - 1, -1, -1):
        F = work.factor[k]
        for i in range(3, -1, -1):
            value = x[4 * k + i]
            # the newest entry last: it is available last
            for j in range(10, i, -1):
                value -= F[i, j] * x[4 * k + j]
            x[4 * k + i] = value * F[i, i]


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
            size = max(size, abs(x[c]), abs(x[4 * count + 3 + c]))
            if math.isnan(size + x[at]):
                return math.nan
            largest = max(largest, size)
        largest = max(largest, abs(x[4 * k + 3]))
    return largest


@helper
def pull(mesh, work, inv):
    """Update the independent axial forces by the Newton increment."""
    viscous, last = 1.0 + mesh.damping_time * inv, work.normal.size - 1
    x = work.change
    for k in range(last):
        g = work.stretch[k]
        value = g[3] * x[4 * k + 3] + g[7] * x[4 * k + 7]
        for i in range(3):
            s = x[4 * k + 4 + i] - x[4 * k + i]
            if k == 0:
                s = x[i]
            value += g[i] * s + g[4 + i] * (x[4 * k + 8 + i] - x[4 * k + 4 + i])
        work.tension[k] = work.normal[k] + mesh.axial[k] * viscous * value
