"""Compiled kernels of the planar Cosserat rod: elements, block elimination, time step.

Geometrically exact rod after Reissner (1972) and Simo (1985). With the section's angle a,
t = (cos a, sin a) and d = (-sin a, cos a), the strains are t.r', d.r' and a'. Their differences
from the natural values, times EA, kappa GA and EI, are the normal force N, the shear force Q and
the moment M. With f = N t + Q d, the gradient of the energy over two Gauss points of weight w is

    dE = sum w ( f.dr' + (N d.r' - Q t.r') da + M da' ).

Kelvin-Voigt damping adds beta times the strain rates to the strains. An element's tangent is
9 x 9. The elimination goes from base to tip, six unknowns an element, so that the unsymmetric term
of a follower force at the tip enters the last 3 x 3 block alone. A negative pivot means that the
tangent is not positive definite: the number of negative pivots is the number of unstable
directions.

N and Q are independent unknowns at the Gauss points and enter the geometric stiffness (mixed
integration points; Magisano, Leonetti, Garcea 2017). The solution is the same, but Newton's method
converges in fewer iterations and from farther away where stretch and shear are much stiffer than
bending; without this it fails where shear is switched off.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slot_core.compiled import helper, kernel
from slot_core.robot import Array
from slot_core.rod.model import SHAPE, Mesh

NODES = ((float(SHAPE[0, 0]), float(SHAPE[0, 1]), float(SHAPE[0, 2])),
         (float(SHAPE[1, 0]), float(SHAPE[1, 1]), float(SHAPE[1, 2])))  # fmt: skip

LARGEST_INCREMENT = 1.0  # rod lengths and rad; a step that ends with more has diverged


class RodWork(NamedTuple):
    """State and scratch arrays of a rod, allocated once."""

    pose: Array  # (n, 3) m, m, rad
    velocity: Array  # (n, 3) m/s, m/s, rad/s
    stage: Array  # (n, 3) pose at the stage t + theta h
    speed: Array  # (n, 3) V, velocity at the stage
    change: Array  # (n, 3) Newton increment
    factor: Array  # (E, 9, 10) tangent | -gradient of the elements, factorised in place
    last: Array  # (3, 4) the same of the tip node
    unknowns: Array  # (3 n,) view of change
    measure: Array  # (E, 2, 6) cos, sin, t.r', d.r' at the stage; their N and Q times weight
    stress: Array  # (E, 2, 2) independent N and Q, times weight
    unconverged: Array  # (1,) steps whose last increment was above the tolerance


def work_space(mesh: Mesh) -> RodWork:
    """Work arrays of a rod at rest in its natural shape."""
    elements, nodes = len(mesh.axial), len(mesh.natural)
    change = np.zeros((nodes, 3))
    return RodWork(
        pose=mesh.natural.copy(),
        velocity=np.zeros((nodes, 3)),
        stage=mesh.natural.copy(),
        speed=np.zeros((nodes, 3)),
        change=change,
        unknowns=change.reshape(-1),
        factor=np.zeros((elements, 9, 10)),
        last=np.zeros((3, 4)),
        measure=np.zeros((elements, 2, 6)),
        stress=np.zeros((elements, 2, 2)),
        unconverged=np.zeros(1, dtype=np.int64),
    )


@helper
def strain(mesh, q, k, g):
    """cos, sin of the angle, strains t.r', d.r', a' at Gauss point g; the element starts at k."""
    n, p = NODES[g], mesh.slope[g]
    x = p[0] * q[k, 0] + p[1] * q[k + 1, 0] + p[2] * q[k + 2, 0]
    y = p[0] * q[k, 1] + p[1] * q[k + 1, 1] + p[2] * q[k + 2, 1]
    bend = p[0] * q[k, 2] + p[1] * q[k + 1, 2] + p[2] * q[k + 2, 2]
    angle = n[0] * q[k, 2] + n[1] * q[k + 1, 2] + n[2] * q[k + 2, 2]
    c, s = math.cos(angle), math.sin(angle)
    return c, s, c * x + s * y, c * y - s * x, bend


@helper
def strain_rate(mesh, v, k, g, c, s, along, across):
    """Rates of the three strains under the velocities or increments v."""
    n, p = NODES[g], mesh.slope[g]
    x = p[0] * v[k, 0] + p[1] * v[k + 1, 0] + p[2] * v[k + 2, 0]
    y = p[0] * v[k, 1] + p[1] * v[k + 1, 1] + p[2] * v[k + 2, 1]
    bend = p[0] * v[k, 2] + p[1] * v[k + 1, 2] + p[2] * v[k + 2, 2]
    turn = n[0] * v[k, 2] + n[1] * v[k + 1, 2] + n[2] * v[k + 2, 2]
    return c * x + s * y + across * turn, c * y - s * x - along * turn, bend


@helper
def point(mesh, work, e, g, inv):
    """Gradient (x, y, a, a') and tangent (xx, xy, yy, xa, ya, aa, a'a') at Gauss point g.

    inv is 1 / (theta h), and 0 in statics. Writes work.measure for `_update_stress`.
    """
    beta, viscous = mesh.damping_time, 1.0 + mesh.damping_time * inv
    c, s, along, across, bend = strain(mesh, work.stage, 2 * e, g)
    e1, e2, e3 = along - mesh.strain[e, g, 0], across - mesh.strain[e, g, 1], bend
    e3 -= mesh.strain[e, g, 2]
    if beta * inv > 0.0:
        r1, r2, r3 = strain_rate(mesh, work.speed, 2 * e, g, c, s, along, across)
        e1, e2, e3 = e1 + beta * r1, e2 + beta * r2, e3 + beta * r3
    axial, shear, bending = mesh.axial[e, g], mesh.shear[e, g], mesh.bending[e, g]
    normal, lateral, moment = axial * e1, shear * e2, bending * e3
    measure = work.measure[e, g]
    measure[0], measure[1], measure[2], measure[3] = c, s, along, across
    measure[4], measure[5] = normal, lateral
    fx, fy = normal * c - lateral * s, normal * s + lateral * c
    turn = normal * across - lateral * along
    normal, lateral = work.stress[e, g, 0], work.stress[e, g, 1]
    axial, shear, bending = axial * viscous, shear * viscous, bending * viscous
    hxx = axial * c * c + shear * s * s
    hxy = (axial - shear) * c * s
    hyy = axial * s * s + shear * c * c
    u, v = axial * across - lateral, normal - shear * along
    hxa, hya = u * c - v * s, u * s + v * c
    haa = axial * across * across + shear * along * along - normal * along - lateral * across
    return (fx, fy, turn, moment), (hxx, hxy, hyy, hxa, hya, haa, bending)


@helper
def element(mesh, work, e, inv, F):
    """Write the tangent (upper half) and the negative gradient of element e to F (9, 10).

    a and b are nodes. At the first and the second Gauss point: p and q are slopes, n and m shape
    functions, f and g gradients, h and k tangents.
    """
    f, h = point(mesh, work, e, 0, inv)
    g, k = point(mesh, work, e, 1, inv)
    (n0, m0), slope = NODES, mesh.slope
    for a in range(3):
        i, p, q, n, m = 3 * a, slope[0, a], slope[1, a], n0[a], m0[a]
        F[i, 9] = -p * f[0] - q * g[0]
        F[i + 1, 9] = -p * f[1] - q * g[1]
        F[i + 2, 9] = -n * f[2] - m * g[2] - p * f[3] - q * g[3]
        for b in range(a, 3):
            j, pb, qb, nb, mb = 3 * b, slope[0, b], slope[1, b], n0[b], m0[b]
            pp, qq = p * pb, q * qb
            F[i, j] = pp * h[0] + qq * k[0]
            F[i, j + 1] = pp * h[1] + qq * k[1]
            F[i, j + 2] = p * nb * h[3] + q * mb * k[3]
            F[i + 1, j] = pp * h[1] + qq * k[1]
            F[i + 1, j + 1] = pp * h[2] + qq * k[2]
            F[i + 1, j + 2] = p * nb * h[4] + q * mb * k[4]
            F[i + 2, j] = n * pb * h[3] + m * qb * k[3]
            F[i + 2, j + 1] = n * pb * h[4] + m * qb * k[4]
            F[i + 2, j + 2] = n * nb * h[5] + m * mb * k[5] + pp * h[6] + qq * k[6]


@helper
def node(mesh, work, load, i, inv, shift, F, row):
    """Add inertia, shift and loads of node i to the diagonal and the last column of F."""
    for c in range(3):
        mass = mesh.mass[i, c] * inv
        F[row + c, row + c] += mass * inv + shift * mesh.metric[i, c]
        force = load[i, c] - mass * (work.speed[i, c] - work.velocity[i, c])
        F[row + c, F.shape[1] - 1] += force


@helper
def prescribe(held, F, rows):
    """Replace the equations of the prescribed unknowns among the first three of F by x = 0."""
    for c in range(3):
        if held[c]:
            for j in range(F.shape[1]):
                F[c, j] = 0.0
            for i in range(rows):
                F[i, c] = 0.0
            F[c, c] = 1.0


@helper
def eliminate(mesh, work, load, follower, inv, shift):
    """Factorise the tangent from base to tip; returns the number of negative pivots.

    Each pivot depends on the one before. The elements are independent and are therefore assembled
    first, which lets the processor work on several at once.
    """
    negative, elements = 0, mesh.axial.shape[0]
    for e in range(elements):
        element(mesh, work, e, inv, work.factor[e])
    for e in range(elements):
        F = work.factor[e]
        if e > 0:
            before = work.factor[e - 1]
            for i in range(3):
                F[i, 9] += before[6 + i, 9]
                for j in range(i, 3):
                    F[i, j] += before[6 + i, 6 + j]
        node(mesh, work, load, 2 * e, inv, shift, F, 0)
        node(mesh, work, load, 2 * e + 1, inv, shift, F, 3)
        if e == 0:
            prescribe(mesh.held[0], F, 9)
        for i in range(6):
            negative += F[i, i] < 0.0
            pivot = 1.0 / F[i, i]
            for r in range(i + 1, 9):
                ratio = F[i, r] * pivot
                for c in range(r, 10):
                    F[r, c] -= ratio * F[i, c]
            F[i, i] = pivot
    return negative + _last(mesh, work, load, follower, inv, shift)


@helper
def _last(mesh, work, load, follower, inv, shift):
    """Factorise the tip's block with the unsymmetric term of the follower force."""
    F, before = work.last, work.factor[-1]
    tip = work.stage.shape[0] - 1
    for i in range(3):
        F[i, 3] = before[6 + i, 9]
        for j in range(3):
            F[i, j] = before[6 + min(i, j), 6 + max(i, j)]
    node(mesh, work, load, tip, inv, shift, F, 0)
    c, s = math.cos(work.stage[tip, 2]), math.sin(work.stage[tip, 2])
    fx, fy = c * follower[0] - s * follower[1], s * follower[0] + c * follower[1]
    F[0, 3], F[1, 3] = F[0, 3] + fx, F[1, 3] + fy
    F[0, 2], F[1, 2] = F[0, 2] + fy, F[1, 2] - fx
    prescribe(mesh.held[1], F, 3)
    negative = 0
    for i in range(3):
        negative += F[i, i] < 0.0
        F[i, i] = 1.0 / F[i, i]
        for r in range(i + 1, 3):
            ratio = F[r, i] * F[i, i]
            for k in range(i + 1, 4):
                F[r, k] -= ratio * F[i, k]
    return negative


@helper
def substitute(mesh, work):
    """Write the Newton increment to work.change; returns its largest entry, rad or rod lengths."""
    x, F, tip = work.unknowns, work.last, work.unknowns.size - 3
    for i in range(2, -1, -1):
        value = F[i, 3]
        for j in range(i + 1, 3):
            value -= F[i, j] * x[tip + j]
        x[tip + i] = value * F[i, i]
    for e in range(mesh.axial.shape[0] - 1, -1, -1):
        F, k = work.factor[e], 6 * e
        for i in range(5, -1, -1):
            value = F[i, 9]
            for j in range(8, i, -1):  # the newest entry last: it is available last
                value -= F[i, j] * x[k + j]
            x[k + i] = value * F[i, i]
    return _largest(work.change, 1.0 / mesh.length)


@helper
def _largest(change, scale):
    """Largest absolute entry, positions times scale; NaN if any entry is NaN."""
    largest = 0.0
    for i in range(change.shape[0]):
        for c in range(3):
            size = abs(change[i, c]) * (scale if c < 2 else 1.0)
            if math.isnan(size):
                return size
            largest = max(largest, size)
    return largest


@helper
def advance(mesh, work, load, follower, target, h, theta, iterations, tolerance):
    """One step of the theta scheme; returns the largest entry of the last Newton increment.

    The Newton iteration starts from the velocity of the step before.
    """
    q, v, stage, speed = work.pose, work.velocity, work.stage, work.speed
    reach, nodes = theta * h, q.shape[0]
    inv, size = 1.0 / reach, 0.0
    for i in range(nodes):
        for c in range(3):
            speed[i, c] = v[i, c]
    _drive_supports(mesh, q, speed, target, h)
    for i in range(nodes):
        for c in range(3):
            stage[i, c] = q[i, c] + reach * speed[i, c]
    for _ in range(iterations):
        eliminate(mesh, work, load, follower, inv, 0.0)
        size = substitute(mesh, work)
        _update_stress(mesh, work, inv)
        for i in range(nodes):
            for c in range(3):
                stage[i, c] += work.change[i, c]
                speed[i, c] += work.change[i, c] * inv
        if not size > tolerance:
            break
    for i in range(nodes):
        for c in range(3):
            q[i, c] += h * speed[i, c]
            factor = 1.0 / theta if mesh.mass[i, c] > 0.0 else 1.0
            v[i, c] += (speed[i, c] - v[i, c]) * factor
    _support_velocity(mesh, v, speed)
    return size


@helper
def _drive_supports(mesh, q, speed, target, h):
    """Set the velocities that move the supported components to their targets (2, 3) within h."""
    for end in range(2):
        i = end * (q.shape[0] - 1)
        for c in range(3):
            if mesh.held[end, c]:
                speed[i, c] = (target[end, c] - q[i, c]) / h


@helper
def _support_velocity(mesh, v, speed):
    """Set supported components to the velocity of the stage, without extrapolation."""
    for end in range(2):
        i = end * (v.shape[0] - 1)
        for c in range(3):
            if mesh.held[end, c]:
                v[i, c] = speed[i, c]


@kernel
def run(mesh, work, load, follower, target, h, theta, iterations, tolerance, steps, record):
    """Advance `steps` steps; writes the tip's pose to record (m, 3) every steps/m steps.

    Returns the number of steps done. It is less than `steps` where the last Newton increment of a
    step was not finite or above LARGEST_INCREMENT.
    """
    every = max(1, steps // max(1, record.shape[0]))
    for n in range(steps):
        size = advance(mesh, work, load, follower, target, h, theta, iterations, tolerance)
        if not size < LARGEST_INCREMENT:
            return n
        work.unconverged[0] += size > tolerance
        if (n + 1) % every == 0 and (n + 1) // every <= record.shape[0]:
            for c in range(3):
                record[(n + 1) // every - 1, c] = work.pose[-1, c]
    return steps


@kernel
def equilibrium(mesh, work, load, follower, shift, iterations, tolerance):
    """Newton's method for an equilibrium, from work.stage.

    With shift > 0 the tangent is augmented by shift times the metric: the iterations are then
    damped steps. Returns (largest entry of the last increment, negative pivots, iterations).
    """
    size, negative = math.inf, 0
    for n in range(iterations):
        negative = eliminate(mesh, work, load, follower, 0.0, shift)
        size = substitute(mesh, work)
        if not size < math.inf:
            return size, negative, n + 1
        _update_stress(mesh, work, 0.0)
        for i in range(work.stage.shape[0]):
            for c in range(3):
                work.stage[i, c] += work.change[i, c]
        if size < tolerance:
            return size, negative, n + 1
    return size, negative, iterations


@kernel
def stress_of(mesh, work):
    """Set the independent N and Q to those of the poses work.stage."""
    for e in range(mesh.axial.shape[0]):
        for g in range(2):
            point(mesh, work, e, g, 0.0)
            work.stress[e, g, 0], work.stress[e, g, 1] = (
                work.measure[e, g, 4],
                work.measure[e, g, 5],
            )


@helper
def _update_stress(mesh, work, inv):
    """Update N and Q by the Newton increment: stiffness times the linearised strains."""
    viscous = 1.0 + mesh.damping_time * inv
    for e in range(mesh.axial.shape[0]):
        for g in range(2):
            m = work.measure[e, g]
            d1, d2, _ = strain_rate(mesh, work.change, 2 * e, g, m[0], m[1], m[2], m[3])
            work.stress[e, g, 0] = m[4] + mesh.axial[e, g] * viscous * d1
            work.stress[e, g, 1] = m[5] + mesh.shear[e, g] * viscous * d2


@kernel
def dense(mesh, work, load, follower, matrix):
    """Write the tangent at work.stage to matrix (3 n, 3 n), supported unknowns included."""
    matrix[:] = 0.0
    F = work.factor[0]
    for e in range(mesh.axial.shape[0]):
        element(mesh, work, e, 0.0, F)
        for i in range(9):
            for j in range(9):
                matrix[6 * e + i, 6 * e + j] += F[min(i, j), max(i, j)]
    tip = work.stage.shape[0] - 1
    c, s = math.cos(work.stage[tip, 2]), math.sin(work.stage[tip, 2])
    matrix[3 * tip, 3 * tip + 2] += s * follower[0] + c * follower[1]
    matrix[3 * tip + 1, 3 * tip + 2] -= c * follower[0] - s * follower[1]


@kernel
def elastic_energy(mesh, pose):
    """Elastic energy of poses (n, 3), J."""
    total = 0.0
    for e in range(mesh.axial.shape[0]):
        for g in range(2):
            _, _, along, across, bend = strain(mesh, pose, 2 * e, g)
            e1, e2 = along - mesh.strain[e, g, 0], across - mesh.strain[e, g, 1]
            e3 = bend - mesh.strain[e, g, 2]
            total += mesh.axial[e, g] * e1 * e1 + mesh.shear[e, g] * e2 * e2
            total += mesh.bending[e, g] * e3 * e3
    return total / 2
