"""Compiled parts of the MPC on tendon angles: prediction and elimination of the states."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from slot_core.compiled import kernel


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
