"""Compiled parts of the MPC on tendon angles: model, prediction, elimination of the states."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from slot_core.compiled import helper, kernel


@kernel
def linearise(springs, geometry, wrench, rates, work, shift, model):  # noqa: PLR0917
    """Discrete model of every stage, and the shift of its equilibrium, into `shift` and `model`.

    springs: contact, slope, stiffness and reference force of the legs, (H, 4) each. geometry: X, Y
    of the clamps, x and y of the legs' directions (4, 4), and dh/dq of the clamps (4, 3). wrench
    (3,): disturbance and gravity. rates: shares that posture and servos keep in a step, and the
    bound of the stiffness. work: (3, 4), (3, 3) and (3, 5). shift (H, 3, 5): -A^-1 [B, e + d].
    model: as of `condense`.
    """
    contact, slope, stiffness, force = springs
    legs, rise = geometry
    keep, held, bound = rates
    a, b, drift = model
    lever, matrix, right = work
    for k in range(len(contact)):
        matrix[:], right[:] = 0.0, 0.0
        for i in range(4):
            lever[0, i] = 1.0
            lever[1, i] = legs[1, i] + contact[k, i] * legs[3, i]
            lever[2, i] = -legs[0, i] - contact[k, i] * legs[2, i]
            for r in range(3):
                for c in range(3):
                    matrix[r, c] += lever[r, i] * min(stiffness[k, i], bound) * rise[i, c]
                right[r, i] = lever[r, i] * slope[k, i]
                right[r, 4] += lever[r, i] * force[k, i]
        for r in range(3):
            right[r, 4] += wrench[r]
        _solve(matrix, right)
        for r in range(3):
            for c in range(5):
                shift[k, r, c] = -right[r, c]
            a[k, r, r] = keep
            drift[k, r] = (1.0 - keep) * shift[k, r, 4]
            for i in range(4):
                a[k, r, 3 + i] = (1.0 - keep) * (1.0 + held) / 2.0 * shift[k, r, i]
                b[k, r, i] = (1.0 - keep) * (1.0 - held) / 2.0 * shift[k, r, i]
        for i in range(4):
            a[k, 3 + i, 3 + i] = held
            b[k, 3 + i, i] = 1.0 - held


@helper
def _solve(matrix, right):
    """Solution of matrix (n, n) x = right (n, m), into `right`; elimination with pivots."""
    size = len(matrix)
    for k in range(size):
        pivot = k
        for r in range(k + 1, size):
            if abs(matrix[r, k]) > abs(matrix[pivot, k]):
                pivot = r
        for c in range(size):
            matrix[k, c], matrix[pivot, c] = matrix[pivot, c], matrix[k, c]
        for c in range(right.shape[1]):
            right[k, c], right[pivot, c] = right[pivot, c], right[k, c]
        for r in range(size):
            if r != k:
                share = matrix[r, k] / matrix[k, k]
                for c in range(k, size):
                    matrix[r, c] -= share * matrix[k, c]
                for c in range(right.shape[1]):
                    right[r, c] -= share * right[k, c]
    for r in range(size):
        for c in range(right.shape[1]):
            right[r, c] /= matrix[r, r]


@kernel
def limit_forces(springs, rise, condensed, rows, force):
    """Normal forces at the states 1 .. H: -rows u + force, into rows (4 H, 4 H) and force (4 H,).

    springs as of `linearise`; condensed: effect and free of `condense`.
    """
    _, slope, stiffness, reference = springs
    effect, free = condensed
    count, columns = len(slope), rows.shape[1]
    for k in range(count):
        ahead = min(k + 1, count - 1)
        for i in range(4):
            row = 4 * k + i
            total = reference[ahead, i] + slope[ahead, i] * free[k, 3 + i]
            for j in range(3):
                total += stiffness[ahead, i] * rise[i, j] * free[k, j]
            force[row] = total
            for column in range(columns):
                value = slope[ahead, i] * effect[k, 3 + i, column]
                for j in range(3):
                    value += stiffness[ahead, i] * rise[i, j] * effect[k, j, column]
                rows[row, column] = -value


@kernel
def condense(model, start, effect, free):
    """States 1 .. H as free + effect u, from x_k+1 = a x_k + b u_k + drift.

    model: a (H, n, n), b (H, n, m), drift (H, n); start (n,): state 0. Writes effect (H, n, H m),
    whose elements above the block diagonal are zero already, and free (H, n).
    """
    a, b, drift = model
    count, size = free.shape
    inputs = b.shape[2]
    for k in range(count):
        for i in range(size):
            value = drift[k, i]
            for j in range(size):
                value += a[k, i, j] * (start[j] if k == 0 else free[k - 1, j])
            free[k, i] = value
            for column in range(inputs * k):
                total = 0.0
                for j in range(size):
                    total += a[k, i, j] * effect[k - 1, j, column]
                effect[k, i, column] = total
            for column in range(inputs):
                effect[k, i, inputs * k + column] = b[k, i, column]


@kernel
def predict(model, start, inputs, states):
    """States 0 .. H (H+1, n) for inputs (H, m), into `states`."""
    a, b, drift = model
    count, size = drift.shape
    for i in range(size):
        states[0, i] = start[i]
    for k in range(count):
        for i in range(size):
            value = drift[k, i]
            for j in range(size):
                value += a[k, i, j] * states[k, j]
            for j in range(b.shape[2]):
                value += b[k, i, j] * inputs[k, j]
            states[k + 1, i] = value
