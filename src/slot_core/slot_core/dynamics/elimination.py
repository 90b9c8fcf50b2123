"""Elimination of a leg from its tip to its clamp, in one step of Newton's method.

The part of a leg beyond node i acts on the rest through the node's displacement X and the angle phi
of the segment before it. Its equations are a quadratic form

    F (7 x 8) over (X_x, X_z, phi, q_1, q_2, q_3, lambda | 1)

with q the torso's increments (y, turn about x, turn about z) in leg axes, lambda the change of the
tendon's tension, and the last column the gradient. One segment is one 2 x 2 pivot: with s the
difference of its nodes' displacements, a = normal / length and the form of the part beyond it,

    X_i = X_k + s,      phi_k = a.s,      s = -P^-1 (right-hand sides of the other unknowns).

A taut tendon adds lambda dl - lambda^2 / (2 kappa), with kappa = k + c / (theta h), in place of its
full matrix kappa grad l grad l^T. At the clamp lambda goes last; the six displacements then left
are those of the torso, and the form is the leg's part of the torso's 6 x 6 Schur complement.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

from typing import NamedTuple

from slot_core.dynamics.compiled import helper
from slot_core.dynamics.contact import touch


class Column(NamedTuple):
    """How the displacements (X_x, X_z, phi) are coupled to one other unknown."""

    x: float
    z: float
    phi: float


class Pivot(NamedTuple):
    """Inverse of a symmetric 2 x 2 matrix."""

    xx: float
    xz: float
    zz: float
    positive: bool


class Node(NamedTuple):
    """Tangent C and gradient g of a node (in leg axes), and y's share in q: (1, jx, jz)."""

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
def eliminate(model, work, leg, inv, height):  # noqa: PLR0915 - one pivot reads best whole
    """Eliminate the segments of a leg from tip to clamp; False where a pivot is not positive.

    The form over (X, phi) stands in local variables, its rest over (q, lambda | 1) in `rest`.
    """
    s, rest = work.segments, work.rest
    viscous = 1.0 + model.rod.damping_time * inv
    q1 = q2 = q3 = cable = one = Column(0.0, 0.0, 0.0)
    xx = xz = zz = xf = zf = ff = 0.0
    definite = True
    rest[:] = 0.0
    for i in range(s.length.size, 0, -1):
        node = _node(model, work, leg, i, inv, height)
        xx, xz, zz = xx + node.cxx, xz + node.cxz, zz + node.czz
        q1, q2, q3 = _add(q1, node, 1.0), _add(q2, node, node.jx), _add(q3, node, node.jz)
        one = Column(one.x + node.gx, one.z + node.gz, one.phi)
        _add_lateral(rest, node)
        # The segment between nodes k and i: X_i = X_k + s and phi_k = a.s; s is eliminated.
        k = i - 1
        tx, tz, length = s.direction[k, 0], s.direction[k, 1], s.length[k]
        force, moment = s.force[k], s.moment[k]
        ax, az = -tz / length, tx / length
        bx, bz = xf + ax * ff, zf + az * ff
        x, z = (xx + ax * xf, xz + az * xf), (xz + ax * zf, zz + az * zf)
        # Its tangent: stretch, bending and the turning of its force, the turning of its moments.
        stretch, bend = viscous * model.rod.axial[k], viscous * model.rod.bending[k]
        across = bend + force * length
        twist = (moment - s.moment[i]) / length
        p = _inverse(
            x[0] + bx * ax + stretch * tx * tx + across * ax * ax - 2.0 * twist * tx * ax,
            z[0] + bx * az + stretch * tx * tz + across * ax * az - twist * (tx * az + tz * ax),
            z[1] + bz * az + stretch * tz * tz + across * az * az - 2.0 * twist * tz * az,
        )
        definite &= p.positive
        # Right-hand sides r and solutions w: how s follows each of the other unknowns.
        along, around = model.tendon.along[k], model.tendon.around[k]
        phi = (-bend * ax, -bend * az)
        r1, r2, r3 = _lift(q1, ax, az), _lift(q2, ax, az), _lift(q3, ax, az)
        rc, ro = _lift(cable, ax, az), _lift(one, ax, az)
        rc = (rc[0] + along * tx + around * ax, rc[1] + along * tz + around * az)
        ro = (ro[0] + force * tx + moment * ax, ro[1] + force * tz + moment * az)
        wx, wz, wf = _over(p, x), _over(p, z), _over(p, phi)
        w1, w2, w3, wc, wo = _over(p, r1), _over(p, r2), _over(p, r3), _over(p, rc), _over(p, ro)
        _store(work.back[leg, k], wx, wz, wf, w1, w2, w3, wc, wo)
        # What is left acts on node k and on the segment before it.
        q1, q2, q3 = _fold(q1, x, z, phi, w1), _fold(q2, x, z, phi, w2), _fold(q3, x, z, phi, w3)
        cable, one = _fold(cable, x, z, phi, wc), _fold(one, x, z, phi, wo)
        cable = Column(cable.x, cable.z, cable.phi - around)
        one = Column(one.x, one.z, one.phi - moment)
        xx, xz, zz = xx - _dot(x, wx), xz - _dot(x, wz), zz - _dot(z, wz)
        xf, zf, ff = -_dot(x, wf), -_dot(z, wf), bend - _dot(phi, wf)
        _gather(rest, r1, r2, r3, rc, w1, w2, w3, wc, wo)
        work.lever[leg, k, 0], work.lever[leg, k, 1] = ax, az
    node = _node(model, work, leg, 0, inv, height)
    xx, xz, zz = xx + node.cxx, xz + node.cxz, zz + node.czz
    _add_lateral(rest, node)
    one = Column(one.x + node.gx, one.z + node.gz, one.phi)
    F = work.form
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
def _node(model, work, leg, i, inv, height):
    """Inertia, weight and contact of a node."""
    u, before, g, up = (
        work.velocity[leg, i],
        work.before[leg, i],
        work.leg_field[1],
        work.leg_field[0],
    )
    rx, ry, rz = model.root[leg, 0], model.root[leg, 1], model.root[leg, 2]
    rx, rz = rx + work.stage[leg, i, 0], rz + work.stage[leg, i, 1]
    mass = model.rod.mass[i]
    gx = mass * ((u[0] - before[0]) * inv - g[0])
    gy = mass * ((u[1] - before[1]) * inv - g[1])
    gz = mass * ((u[2] - before[2]) * inv - g[2])
    inertia = mass * inv * inv
    gap = height + up[0] * rx + up[1] * ry + up[2] * rz
    if gap < 0.0 and i > 0:  # the clamp is inside the torso, whose corners touch the floor
        vn = up[0] * u[0] + up[1] * u[1] + up[2] * u[2]
        normal, drag = touch(model.floor, model.friction[leg], gap, vn, u[0], u[1], u[2])
        if normal > 0.0:
            stiff = model.floor.stiffness + (model.floor.damping - drag) * inv
            inertia += drag * inv
            return Node(
                inertia + stiff * up[0] * up[0],
                stiff * up[0] * up[1],
                stiff * up[0] * up[2],
                inertia + stiff * up[1] * up[1],
                stiff * up[1] * up[2],
                inertia + stiff * up[2] * up[2],
                gx - up[0] * (normal + drag * vn) + drag * u[0],
                gy - up[1] * (normal + drag * vn) + drag * u[1],
                gz - up[2] * (normal + drag * vn) + drag * u[2],
                -rz,
                rx,
            )
    return Node(inertia, 0.0, 0.0, inertia, 0.0, inertia, gx, gy, gz, -rz, rx)


@helper
def _add(column, node, share):
    """Add to a column of q what a node couples between its plane and y."""
    return Column(column.x + node.cxy * share, column.z + node.cyz * share, column.phi)


@helper
def _add_lateral(rest, node):
    """Add what a node gives to q alone."""
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
def _inverse(xx, xz, zz):
    det = xx * zz - xz * xz
    scale = 1.0 / det
    return Pivot(zz * scale, -xz * scale, xx * scale, det > 0.0 and xx > 0.0)


@helper
def _over(p, r):
    """The inverse p times r."""
    return p.xx * r[0] + p.xz * r[1], p.xz * r[0] + p.zz * r[1]


@helper
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1]


@helper
def _lift(column, ax, az):
    """Right-hand side of s from a column, with phi = a.s."""
    return column.x + ax * column.phi, column.z + az * column.phi


@helper
def _fold(column, x, z, phi, w):
    """A column after the elimination of s, which follows its unknown with -w."""
    return Column(column.x - _dot(x, w), column.z - _dot(z, w), -_dot(phi, w))


@helper
def _gather(rest, r1, r2, r3, rc, w1, w2, w3, wc, wo):
    """Subtract r.w from the form over (q, lambda | 1), upper half."""
    rest[0, 0] -= _dot(r1, w1)
    rest[0, 1] -= _dot(r1, w2)
    rest[0, 2] -= _dot(r1, w3)
    rest[0, 3] -= _dot(r1, wc)
    rest[0, 4] -= _dot(r1, wo)
    rest[1, 1] -= _dot(r2, w2)
    rest[1, 2] -= _dot(r2, w3)
    rest[1, 3] -= _dot(r2, wc)
    rest[1, 4] -= _dot(r2, wo)
    rest[2, 2] -= _dot(r3, w3)
    rest[2, 3] -= _dot(r3, wc)
    rest[2, 4] -= _dot(r3, wo)
    rest[3, 3] -= _dot(rc, wc)
    rest[3, 4] -= _dot(rc, wo)


@helper
def _store(back, wx, wz, wf, w1, w2, w3, wc, wo):
    """Keep how s follows (X, phi, q, lambda, 1) for the substitution."""
    for r in range(2):
        back[r, 0], back[r, 1], back[r, 2] = wx[r], wz[r], wf[r]
        back[r, 3], back[r, 4], back[r, 5] = w1[r], w2[r], w3[r]
        back[r, 6], back[r, 7] = wc[r], wo[r]


@helper
def _write(form, c, column):
    form[0, c], form[1, c], form[2, c] = column.x, column.z, column.phi


@helper
def couple(model, work, leg, inv):
    """Eliminate lambda and add the leg's form to the torso's system."""
    F, tendon, release = work.form, model.tendon, work.release[leg]
    stiffness = tendon.stiffness + tendon.damping * inv if work.tension[leg] > 0.0 else 0.0
    factor = stiffness / (1.0 - stiffness * F[6, 6])
    for c in range(6):
        release[c] = factor * F[6, c]
    release[6] = factor * F[6, 7]
    reduced, half, L = work.reduced, work.product, model.clamp[leg]
    for r in range(6):
        for c in range(6):
            reduced[r, c] = F[r, c] + F[r, 6] * release[c]
        reduced[r, 6] = F[r, 7] + F[r, 6] * release[6]
    for r in range(6):
        for c in range(6):
            value = 0.0
            for k in range(6):
                value += reduced[r, k] * L[k, c]
            half[r, c] = value
        half[r, 6] = reduced[r, 6]
    for r in range(6):
        for k in range(6):
            work.vector[r] += L[k, r] * half[k, 6]
            for c in range(6):
                work.matrix[r, c] += L[k, r] * half[k, c]


@helper
def substitute(model, work, leg, inv):
    """Carry the torso's increments through a leg and update V; returns the largest |change|^2."""
    largest = 0.0
    L, x, release = model.clamp[leg], work.vector, work.release[leg]
    rx, rz = model.root[leg, 0], model.root[leg, 2]
    z = work.moved
    z[7] = 1.0
    z[6] = release[6]
    for r in range(6):
        value = 0.0
        for c in range(6):
            value += L[r, c] * x[c]
        z[r] = value
        z[6] += release[r] * value
    work.tension[leg] = max(0.0, work.tension[leg] + z[6])
    for i in range(work.stage.shape[1]):
        if i > 0:
            follow(z, work.back[leg, i - 1], work.lever[leg, i - 1])
        u, stage = work.velocity[leg, i], work.stage[leg, i]
        u[0] += z[0] * inv
        u[1] += (z[3] + (rx + stage[0]) * z[5] - (rz + stage[1]) * z[4]) * inv
        u[2] += z[1] * inv
        largest = max(largest, (z[0] * z[0] + z[1] * z[1]) * inv * inv)
    return largest


@helper
def follow(z, back, lever):
    """Replace X and phi in z (8,), which begin a segment, by those at its end."""
    sx = sz = 0.0
    for c in range(8):
        sx -= back[0, c] * z[c]
        sz -= back[1, c] * z[c]
    z[0] += sx
    z[1] += sz
    z[2] = lever[0] * sx + lever[1] * sz
