"""Tangent and gradient of a rod, hinge by hinge, over the unknowns of Newton's method.

The unknowns are the turn of the base's section (3, and one that is not used), then of every node
its displacement (3) and the turn w of the segment behind it about itself, last the displacement of
the tip's node, the turn of the tip's section (3) and one not used: x has 4 N + 7 entries. The hinge
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

from typing import NamedTuple

from slot_core.compiled import helper
from slot_core.dynamics.algebra import cross, dot, plus, put, row
from slot_core.dynamics.spatial.hinge import bend
from slot_core.dynamics.spatial.strain import frame


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
    return Lever(t, scale, 0.0, plus(ZERO, scale / (1.0 + dot(a, t)), cross(t, a)))


@helper
def acting(lever, m):
    """The four components over (s, w) of a moment m."""
    a, h, q, z, w = cross(m, lever.t), lever.scale, lever.keep, lever.z, dot(m, lever.t)
    return (
        h * a[0] + q * m[0] + w * z[0],
        h * a[1] + q * m[1] + w * z[1],
        h * a[2] + q * m[2] + w * z[2],
        w,
    )


@helper
def hinge(mesh, work, k, inv, before, behind):
    """Write the form of the hinge at node k over (s, w) of the segments before and behind it.

    inv is 1 / (theta h), and 0 in statics; before, behind: levers of both.
    """
    s, beta = work.segments, mesh.damping_time
    viscous = 1.0 + beta * inv
    normal = mesh.axial[k] * (s.extension[k] + beta * s.extension_rate[k])
    f = work.stage_frame[0]
    base = (row(f, 0), row(f, 1), row(f, 2))
    if k > 0:
        base = frame(s, k - 1)
    h = bend(mesh, s, k, base, viscous, work.tension[k], mesh.none, 0.0)
    work.normal[k] = normal
    m = plus(h.moment, normal - work.tension[k], h.bulge)
    m = plus(m, -1.0, _refined(mesh, s, k, base))
    put(work.moment, k, h.moment)
    put(work.residual, k, m)
    _stiffness(work.form, h, before, behind)
    _gradient(work.form, m, normal, before, behind)
    _stretch(
        work.stretch[k], work.form, h.bulge, before, behind, viscous * mesh.axial[k]
    )


@helper
def _refined(mesh, s, k, base):
    """Moment of the hinge's correction `refine.py`, B delta mapped as in `strain.py`."""
    t, d, b = base
    psi, mu = (s.twist[k], s.turn[k], s.side[k]), row(mesh.refinement.delta, k)
    once = cross(psi, mu)
    v = plus(plus(mu, 0.5, once), s.curl[k], cross(psi, once))
    return (
        v[0] * t[0] + v[1] * d[0] + v[2] * b[0],
        v[0] * t[1] + v[1] * d[1] + v[2] * b[1],
        v[0] * t[2] + v[1] * d[2] + v[2] * b[2],
    )


@helper
def _stiffness(Q, h, before, behind):
    """Tangent of the hinge: K on both sides, [m] / 2 - K between them."""
    K, m = h.tangent, h.moment
    k1, k2, k3 = (K.xx, K.xy, K.xz), (K.xy, K.yy, K.yz), (K.xz, K.yz, K.zz)
    c1 = (-K.xx, -K.xy - 0.5 * m[2], -K.xz + 0.5 * m[1])
    c2 = (-K.xy + 0.5 * m[2], -K.yy, -K.yz - 0.5 * m[0])
    c3 = (-K.xz - 0.5 * m[1], -K.yz + 0.5 * m[0], -K.zz)
    _product(Q[:4, :4], k1, k2, k3, before, before)
    _product(Q[:4, 4:8], c1, c2, c3, before, behind)
    _product(Q[4:8, 4:8], k1, k2, k3, behind, behind)


@helper
def _product(out, r1, r2, r3, left, right):
    """out (4, 4) = P_left^T R P_right of a matrix with the rows r1, r2, r3."""
    a, b, c = acting(right, r1), acting(right, r2), acting(right, r3)
    _put_column(out, 0, acting(left, (a[0], b[0], c[0])))
    _put_column(out, 1, acting(left, (a[1], b[1], c[1])))
    _put_column(out, 2, acting(left, (a[2], b[2], c[2])))
    _put_column(out, 3, acting(left, (a[3], b[3], c[3])))


@helper
def _put_column(out, j, v):
    out[0, j], out[1, j], out[2, j], out[3, j] = v[0], v[1], v[2], v[3]


@helper
def _gradient(Q, m, normal, before, behind):
    """Negative gradient of the hinge and of the segment behind it."""
    a, b, t = acting(before, m), acting(behind, m), behind.t
    for i in range(4):
        Q[i, 8], Q[4 + i, 8] = a[i], -b[i]
    for i in range(3):
        Q[4 + i, 8] -= normal * t[i]


@helper
def _stretch(g, Q, bulge, before, behind, axial):
    """Add the axial stiffness of the segment behind the hinge; g (8,): derivative of l - c."""
    a, b, t = acting(before, bulge), acting(behind, bulge), behind.t
    for i in range(4):
        g[i], g[4 + i] = -a[i], b[i]
    for i in range(3):
        g[4 + i] += t[i]
    for i in range(8):
        share = axial * g[i]
        for j in range(8):
            Q[i, j] += share * g[j]


@helper
def own(mesh, work, k, inv, lever):
    """Add the terms of segment k alone to the form, as the segment before a hinge.

    Its geometric stiffness, its spin, and what is left of its inertia (`dynamics/rod.py`). Both
    hinges must have their moments.
    """
    Q, s, t, inertia = work.form, work.segments, lever.t, mesh.spin[k] * inv
    turning = (
        inertia * (work.spin[k] * t[0] - work.swirl[k, 0]),
        inertia * (work.spin[k] * t[1] - work.swirl[k, 1]),
        inertia * (work.spin[k] * t[2] - work.swirl[k, 2]),
    )
    m = plus(plus(row(work.moment, k), -1.0, row(work.moment, k + 1)), 1.0, turning)
    v, p, mu = work.speed, work.before, mesh.coupling[k] * inv
    across, scale = work.tension[k] * s.per_length[k], s.per_length[k]
    q, mt, pull = cross(t, m), dot(m, t), acting(lever, turning)
    for i in range(3):
        g = scale * scale * q[i] - across * t[i]
        for j in range(3):
            Q[i, j] += t[j] * g + scale * scale * q[j] * t[i]
        Q[i, i] += across - mu * inv
        Q[i, 3] += 0.5 * scale * (m[i] - mt * t[i])
        Q[i, 8] += mu * (v[k + 1, i] - v[k, i] - p[k + 1, i] + p[k, i]) - pull[i]
    Q[3, 3] += inertia * inv
    Q[3, 8] -= pull[3]


@helper
def spread(F, Q, sign, share):
    """Write a hinge's form to F (11, 12) over its unknowns; the upper half.

    sign, share: -1 and 1, since s before the hinge is share times the node's displacement plus
    sign times that of the node before; +1 and 0 for the base's section.
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
        F[i, 3], F[i, 7] = sign * Q[i, 3], sign * Q[i, 7]
        F[3, 4 + i], F[3, 8 + i] = share * Q[i, 3] - Q[3, 4 + i], Q[3, 4 + i]
        F[4 + i, 7] = share * Q[i, 7] - Q[4 + i, 7]
        F[7, 8 + i] = Q[4 + i, 7]
        F[i, 11] = sign * Q[i, 8]
        F[4 + i, 11] = share * Q[i, 8] - Q[4 + i, 8]
        F[8 + i, 11] = Q[4 + i, 8]
    F[3, 3], F[3, 7], F[7, 7] = Q[3, 3] + 1.0 - share, Q[3, 7], Q[7, 7]
    F[3, 11], F[7, 11] = Q[3, 8], Q[7, 8]


@helper
def spread_last(F, Q):
    """The same for the tip's hinge."""
    for i in range(3):
        for j in range(3):
            aa, ab = Q[i, j], Q[i, 4 + j]
            F[i, j], F[i, 4 + j], F[4 + i, 4 + j] = aa, -aa, aa
            F[i, 7 + j], F[4 + i, 7 + j] = -ab, ab
            F[7 + i, 7 + j] = Q[4 + i, 4 + j]
        F[i, 3], F[3, 4 + i], F[3, 7 + i] = -Q[i, 3], Q[i, 3], Q[3, 4 + i]
        F[i, 10] = F[4 + i, 10] = F[7 + i, 10] = 0.0
        F[i, 11], F[4 + i, 11], F[7 + i, 11] = -Q[i, 8], Q[i, 8], Q[4 + i, 8]
    F[3, 3], F[3, 10], F[10, 10], F[3, 11], F[10, 11] = Q[3, 3], 0.0, 1.0, Q[3, 8], 0.0


@helper
def assemble(mesh, work, inv):
    """Write the blocks of all hinges to work.factor, at the strains of the iterate."""
    F, Q, last = work.factor, work.form, work.normal.size - 1
    # A hinge's segment before it is complete with the moment of this hinge.
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
