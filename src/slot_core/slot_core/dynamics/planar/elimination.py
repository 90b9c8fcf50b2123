"""Elimination of a planar leg from its tip to its clamp, in one iteration of Newton's method.

The part of a leg beyond node i acts on the rest through the node's displacement X and the angle phi
of the segment before it. Its equations are a quadratic form

    F (7 x 8) over (X_x, X_z, phi, q_1, q_2, q_3, lambda | 1)

with q the torso's increments (y, turn about x, turn about z) in leg axes, lambda the change of the
tendon's tension, and the last column the gradient. Each segment is one 2 x 2 pivot P. With s the
difference of its nodes' displacements and a = normal / length,

    X_i = X_k + s,      phi_k = a.s,      s = -P^-1 (right-hand sides of the other unknowns).

A taut tendon adds lambda dl - lambda^2 / (2 kappa), with kappa = k + c / (theta h), in place of its
full matrix kappa grad l grad l^T. lambda is eliminated last, at the clamp. The form that remains,
over the six displacements of the clamp, is the leg's part of the torso's 6 x 6 Schur complement.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

from typing import NamedTuple

from slot_core.compiled import helper
from slot_core.dynamics.contact import coefficient, friction_force, normal_force, tangential
from slot_core.dynamics.lanes import any_lane, largest, like, where
from slot_core.dynamics.terrain import ground, is_uneven, tilted


class Column(NamedTuple):
    """Column of F: the coupling of (X_x, X_z, phi) to one other unknown."""

    x: float
    z: float
    phi: float


class PlanarPivot(NamedTuple):
    """Inverse of a symmetric 2 x 2 matrix."""

    xx: float
    xz: float
    zz: float
    positive: bool


class Node(NamedTuple):
    """Tangent C and gradient g of a node in leg axes; its displacement along y is q.(1, jx, jz)."""

    cxx: float
    cxy: float
    cxz: float
    cyy: float
    cyz: float
    czz: float
    gx: float
    gy: float
    gz: float
    jx: float
    jz: float


@helper
def eliminate(model, leg, inv, place):  # noqa: PLR0915 - one pivot reads best whole
    """Eliminate the segments of a leg from tip to clamp; returns whether all pivots were positive.

    Writes leg.form and leg.back. inv = 1 / (theta h); place: the torso's centre in odom, m. The
    form over (X, phi) is held in local variables, the rest over (q, lambda | 1) in `rest`.
    """
    s, rest = leg.segments, leg.rest
    viscous = 1.0 + model.rod.damping_time * inv
    xx = xz = zz = xf = zf = ff = like(0.0, leg.friction[0])
    q1 = q2 = q3 = cable = one = Column(xx, xx, xx)
    definite = True
    for r in range(4):
        for c in range(5):
            rest[r, c] = xx
    for i in range(s.length.size, 0, -1):
        node = _node(model, leg, i, inv, place)
        if model.tendon.straight and i == model.tendon.anchor:
            node = _pulled(leg, node)
            cable = Column(cable.x + leg.line[0], cable.z + leg.line[1], cable.phi)
        xx, xz, zz = xx + node.cxx, xz + node.cxz, zz + node.czz
        q1, q2, q3 = _add(q1, node, 1.0), _add(q2, node, node.jx), _add(q3, node, node.jz)
        one = Column(one.x + node.gx, one.z + node.gz, one.phi)
        # The segment between nodes k and i: X_i = X_k + s and phi_k = a.s; s is eliminated.
        k = i - 1
        tx, tz, force, moment = s.direction[k, 0], s.direction[k, 1], s.force[k], s.moment[k]
        length, per_length = s.length[k], s.per_length[k]
        ax, az = -tz * per_length, tx * per_length
        bx, bz = xf + ax * ff, zf + az * ff
        x, z = (xx + ax * xf, xz + az * xf), (xz + ax * zf, zz + az * zf)
        # Its tangent: stretch, bending, the geometric stiffness of its force and moments, and the
        # coupling of the masses. (px, pz) and bulge are the derivatives of l - c by s and phi.
        stretch, shortening = viscous * model.rod.axial[k], -2.0 * model.rod.shortening[k]
        bend = viscous * model.rod.bending[k] + shortening * force
        bulge = shortening * (s.turn[k] - model.rod.rest_angle[k])
        px, pz = tx + bulge * ax, tz + bulge * az
        drift = model.rod.coupling[k] * inv
        own = -drift * inv
        across = bend + force * length
        twist = (moment - s.moment[i]) * per_length
        p = _inverse(
            x[0] + bx * ax + stretch * px * px + across * ax * ax - 2.0 * twist * tx * ax + own,
            z[0] + bx * az + stretch * px * pz + across * ax * az - twist * (tx * az + tz * ax),
            z[1] + bz * az + stretch * pz * pz + across * az * az - 2.0 * twist * tz * az + own,
        )
        definite = definite & p.positive
        # Right-hand sides r of s for each of the other unknowns, and solutions w = P^-1 r.
        along, around = model.tendon.along[k], model.tendon.around[k]
        phi = (-bend * ax - stretch * bulge * px, -bend * az - stretch * bulge * pz)
        r1, r2, r3 = _lift(q1, ax, az), _lift(q2, ax, az), _lift(q3, ax, az)
        rc, ro = _lift(cable, ax, az), _lift(one, ax, az)
        rc = (rc[0] + along * px + around * ax, rc[1] + along * pz + around * az)
        lag = _lag(leg, k)
        ro = (
            ro[0] + force * tx + moment * ax - drift * lag[0],
            ro[1] + force * tz + moment * az - drift * lag[2],
        )
        wx, wz, wf = _over(p, x), _over(p, z), _over(p, phi)
        w1, w2, w3, wc, wo = _over(p, r1), _over(p, r2), _over(p, r3), _over(p, rc), _over(p, ro)
        _store(leg.back[k], wx, wz, wf, w1, w2, w3, wc, wo)
        # The remaining form acts on node k and on the segment before it.
        q1, q2, q3 = _fold(q1, x, z, phi, w1), _fold(q2, x, z, phi, w2), _fold(q3, x, z, phi, w3)
        cable, one = _fold(cable, x, z, phi, wc), _fold(one, x, z, phi, wo)
        cable = Column(cable.x, cable.z, cable.phi - around - along * bulge)
        one = Column(one.x, one.z, one.phi - moment)
        xx, xz, zz = xx - _dot(x, wx), xz - _dot(x, wz), zz - _dot(z, wz)
        xf, zf = -_dot(x, wf), -_dot(z, wf)
        ff = bend + stretch * bulge * bulge - _dot(phi, wf)
        _gather(rest, node, r1, r2, r3, rc, w1, w2, w3, wc, wo)
        _couple_lateral(rest, leg, k, own, drift * lag[1])
    node = _node(model, leg, 0, inv, place)
    xx, xz, zz = xx + node.cxx, xz + node.cxz, zz + node.czz
    _add_lateral(rest, node)
    one = Column(one.x + node.gx, one.z + node.gz, one.phi)
    if model.tendon.straight:
        one = _held(model.tendon, leg, leg.pull[0], one)
        cable = _held(model.tendon, leg, like(1.0, leg.pull[0]), cable)
    F = leg.form
    F[0, 0], F[0, 1], F[0, 2], F[1, 1], F[1, 2], F[2, 2] = xx, xz, xf, zz, zf, ff
    _write(F, 3, q1)
    _write(F, 4, q2)
    _write(F, 5, q3)
    _write(F, 6, cable)
    _write(F, 7, one)
    for r in range(4):
        for c in range(r, 5):
            F[3 + r, 3 + c] = rest[r, c]
    for r in range(1, 7):
        for c in range(r):
            F[r, c] = F[c, r]
    return definite


@helper
def _node(model, leg, i, inv, place):
    """Tangent and gradient of a node: inertia, weight and contact."""
    ux, uy, uz = leg.velocity[i, 0], leg.velocity[i, 1], leg.velocity[i, 2]
    rx, rz = leg.root[0] + leg.stage[i, 0], leg.root[2] + leg.stage[i, 1]
    mass = model.rod.mass[i]
    gx = mass * ((ux - leg.before[i, 0]) * inv - leg.field[3, 0])
    gy = mass * ((uy - leg.before[i, 1]) * inv - leg.field[3, 1])
    gz = mass * ((uz - leg.before[i, 2]) * inv - leg.field[3, 2])
    inertia, none = like(mass * inv * inv, rx), like(0.0, rx)
    node = Node(inertia, none, none, inertia, none, inertia, gx, gy, gz, -rz, rx)
    if i < model.floor.first:
        return node
    f = leg.field
    gap = place[2] + f[2, 0] * rx + f[2, 1] * leg.root[1] + f[2, 2] * rz
    up = (f[2, 0], f[2, 1], f[2, 2])
    if is_uneven(model.floor.terrain):
        east = place[0] + f[0, 0] * rx + f[0, 1] * leg.root[1] + f[0, 2] * rz
        north = place[1] + f[1, 0] * rx + f[1, 1] * leg.root[1] + f[1, 2] * rz
        below = ground(model.floor.terrain, east, north)
        gap, up = tilted(f, below, gap - below.height)
        if model.floor.bristle > 0.0:
            leg.slope[i, 0], leg.slope[i, 1] = below.slope_x, below.slope_y
    if any_lane(gap < 0.0):
        return _touch(model.floor, leg, i, inv, gap, up, node)
    if model.floor.bristle > 0.0:
        leg.limit[i] = none
    return node


@helper
def _touch(floor, leg, i, inv, gap, up, node):
    """Add the floor's force on a node and its tangent; up: the floor's normal in leg axes."""
    ux, uy, uz = leg.velocity[i, 0], leg.velocity[i, 1], leg.velocity[i, 2]
    vn = up[0] * ux + up[1] * uy + up[2] * uz
    v = (ux - vn * up[0], uy - vn * up[1], uz - vn * up[2])
    slip = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    stiffness, damping = floor.stiffness[i], floor.damping[i]
    normal = normal_force(stiffness, damping, gap, vn)
    mu = coefficient(floor, leg.friction[0], leg.friction[1], leg.rate[0], v[0], slip)
    bristle = v
    if floor.bristle > 0.0:
        leg.limit[i] = mu * normal
        bristle = tangential(leg.field, leg.bristle[i], up)
    hold = friction_force(floor, mu * normal, 1.0 / inv, stiffness, damping, bristle, v)
    drag = hold.drag * inv
    stiff = where(normal > 0.0, stiffness + damping * inv - drag, like(0.0, drag))
    return Node(
        node.cxx + drag + stiff * up[0] * up[0],
        stiff * up[0] * up[1],
        stiff * up[0] * up[2],
        node.cyy + drag + stiff * up[1] * up[1],
        stiff * up[1] * up[2],
        node.czz + drag + stiff * up[2] * up[2],
        node.gx + hold.drag * v[0] + hold.x - normal * up[0],
        node.gy + hold.drag * v[1] + hold.y - normal * up[1],
        node.gz + hold.drag * v[2] + hold.z - normal * up[2],
        node.jx,
        node.jz,
    )


@helper
def _pulled(leg, n):
    """Add the pull of a straight tendon on its anchor node, and its geometric stiffness T / l."""
    ux, uz, pull, stiff = leg.line[0], leg.line[1], leg.pull[0], leg.pull[0] * leg.line[2]
    cxx, cxz, czz = n.cxx + stiff * uz * uz, n.cxz - stiff * ux * uz, n.czz + stiff * ux * ux
    gx, gz = n.gx + pull * ux, n.gz + pull * uz
    return Node(cxx, n.cxy, cxz, n.cyy, n.cyz, czz, gx, n.gy, gz, n.jx, n.jz)


@helper
def _held(tendon, leg, pull, column):
    """Add the reaction of a straight tendon at its pulley, which moves with the clamp.

    pull: tension, N, for the gradient, or 1 for the column of lambda.
    """
    ux, uz = pull * leg.line[0], pull * leg.line[1]
    turning = tendon.pulley[0] * uz - tendon.pulley[1] * ux
    return Column(column.x - ux, column.z - uz, column.phi - turning)


@helper
def _add(column, node, share):
    """Add a node's coupling between the leg's plane and y to a column of q; share: 1, jx or jz."""
    return Column(column.x + node.cxy * share, column.z + node.cyz * share, column.phi)


@helper
def _add_lateral(rest, node):
    """Add a node's tangent and gradient along y to the form over q."""
    x, z, c = node.jx, node.jz, node.cyy
    rest[0, 0] += c
    rest[0, 1] += c * x
    rest[0, 2] += c * z
    rest[1, 1] += c * x * x
    rest[1, 2] += c * x * z
    rest[2, 2] += c * z * z
    rest[0, 4] += node.gy
    rest[1, 4] += node.gy * x
    rest[2, 4] += node.gy * z


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
def _couple_lateral(rest, leg, k, own, force):
    """Add the coupling of the masses of a segment's nodes along y to the form over q."""
    x, z = leg.stage[k, 1] - leg.stage[k + 1, 1], leg.stage[k + 1, 0] - leg.stage[k, 0]
    rest[1, 1] += own * x * x
    rest[1, 2] += own * x * z
    rest[2, 2] += own * z * z
    rest[1, 4] -= force * x
    rest[2, 4] -= force * z


@helper
def _inverse(xx, xz, zz):
    """Inverse of a symmetric 2 x 2 matrix, and whether the matrix is positive definite."""
    det = xx * zz - xz * xz
    scale = 1.0 / det
    return PlanarPivot(zz * scale, -xz * scale, xx * scale, (det > 0.0) & (xx > 0.0))


@helper
def _over(p, r):
    """P^-1 r, with p the inverse of P."""
    return p.xx * r[0] + p.xz * r[1], p.xz * r[0] + p.zz * r[1]


@helper
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1]


@helper
def _lift(column, ax, az):
    """Right-hand side of s for the unknown of a column, with phi = a.s."""
    return column.x + ax * column.phi, column.z + az * column.phi


@helper
def _fold(column, x, z, phi, w):
    """A column after the elimination of s = -w times its unknown."""
    return Column(column.x - _dot(x, w), column.z - _dot(z, w), -_dot(phi, w))


@helper
def _gather(rest, node, r1, r2, r3, rc, w1, w2, w3, wc, wo):
    """Form over (q, lambda | 1), upper half: add a node's part along y, subtract r.w."""
    jx, jz, c = node.jx, node.jz, node.cyy
    rest[0, 0] += c - _dot(r1, w1)
    rest[0, 1] += c * jx - _dot(r1, w2)
    rest[0, 2] += c * jz - _dot(r1, w3)
    rest[0, 3] -= _dot(r1, wc)
    rest[0, 4] += node.gy - _dot(r1, wo)
    rest[1, 1] += c * jx * jx - _dot(r2, w2)
    rest[1, 2] += c * jx * jz - _dot(r2, w3)
    rest[1, 3] -= _dot(r2, wc)
    rest[1, 4] += node.gy * jx - _dot(r2, wo)
    rest[2, 2] += c * jz * jz - _dot(r3, w3)
    rest[2, 3] -= _dot(r3, wc)
    rest[2, 4] += node.gy * jz - _dot(r3, wo)
    rest[3, 3] -= _dot(rc, wc)
    rest[3, 4] -= _dot(rc, wo)


@helper
def _store(back, wx, wz, wf, w1, w2, w3, wc, wo):
    """Store the rows of -s over (X, phi, q, lambda, 1) for the back substitution."""
    for r in range(2):
        back[r, 0], back[r, 1], back[r, 2] = wx[r], wz[r], wf[r]
        back[r, 3], back[r, 4], back[r, 5] = w1[r], w2[r], w3[r]
        back[r, 6], back[r, 7] = wc[r], wo[r]


@helper
def _write(form, c, column):
    form[0, c], form[1, c], form[2, c] = column.x, column.z, column.phi


@helper
def substitute(leg, vector, inv):
    """Back substitution of the torso's increments in a leg; updates V and the tension.

    Returns the largest squared change of a node's velocity in the leg's plane, (m/s)^2.
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
    X, q = (moved[0], moved[1], moved[2]), (moved[3], moved[4], moved[5], tension, 1.0)
    most = like(0.0, tension)
    for i in range(leg.stage.shape[0]):
        if i > 0:
            X = follow(leg, i - 1, X, q)
        rx, rz = leg.root[0] + leg.stage[i, 0], leg.root[2] + leg.stage[i, 1]
        leg.velocity[i, 0] += X[0] * inv
        leg.velocity[i, 1] += (q[0] + rx * q[2] - rz * q[1]) * inv
        leg.velocity[i, 2] += X[1] * inv
        most = max(most, X[0] * X[0] + X[1] * X[1])
    return largest(most) * inv * inv


@helper
def follow(leg, k, X, q):
    """Displacements (X_x, X_z, phi) at the end of segment k from those at its begin.

    q = (q_1, q_2, q_3, lambda, 1). Terms that do not depend on the previous segment come first:
    the processor computes them ahead.
    """
    sx = _constant(leg.back, k, 0, q) + leg.back[k, 0, 0] * X[0] + leg.back[k, 0, 1] * X[1]
    sz = _constant(leg.back, k, 1, q) + leg.back[k, 1, 0] * X[0] + leg.back[k, 1, 1] * X[1]
    sx = -(sx + leg.back[k, 0, 2] * X[2])
    sz = -(sz + leg.back[k, 1, 2] * X[2])
    turn = leg.segments.direction[k, 0] * sz - leg.segments.direction[k, 1] * sx
    return X[0] + sx, X[1] + sz, turn * leg.segments.per_length[k]


@helper
def _constant(back, k, r, q):
    value = back[k, r, 3] * q[0] + back[k, r, 4] * q[1] + back[k, r, 5] * q[2]
    return value + back[k, r, 6] * q[3] + back[k, r, 7] * q[4]
