"""Elimination of the rod's unknowns from its base to its tip, and the substitution.

Four unknowns are eliminated with each hinge. The unsymmetric terms of a follower force and of a
dead moment enter the last 6 x 6 block alone. A negative pivot means that the tangent is not
positive definite: the number of negative pivots is the number of unstable directions.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math

from slot_core.compiled import helper
from slot_core.dynamics.algebra import combined, cross, row
from slot_core.rod.assembly import assemble


@helper
def node(mesh, work, dead, i, inv, F, at):
    """Add inertia and dead load of node i to the diagonal and the last column of F.

    dead (N, 3): forces, N; at: row of F of the node's displacement along x.
    """
    mass = mesh.mass[i] * inv
    for c in range(3):
        F[at + c, at + c] += mass * inv
        force = dead[i, c] - mass * (work.speed[i, c] - work.before[i, c])
        F[at + c, F.shape[1] - 1] += force


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

    loads: (dead (N, 3) N, moment (3,) N m, follower (3,) N); shift: times the metric, added.
    """
    negative, count = 0, work.normal.size
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
    return negative + _last(mesh, work, loads, inv, shift)


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
    x, F, count = work.change, work.last, work.normal.size
    at = 4 * count
    x[3] = x[at + 6] = 0.0
    for i in range(5, -1, -1):
        value = F[i, 6]
        for j in range(i + 1, 6):
            value -= F[i, j] * x[at + j]
        x[at + i] = value * F[i, i]
    for k in range(count - 1, -1, -1):
        F = work.factor[k]
        for i in range(3, -1, -1):
            value = F[i, 11]
            # the newest entry last: it is available last
            for j in range(10, i, -1):
                value -= F[i, j] * x[4 * k + j]
            x[4 * k + i] = value * F[i, i]
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
