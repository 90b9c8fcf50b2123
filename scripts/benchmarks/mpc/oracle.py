"""The exact optimum of a `HorizonQp`: states eliminated, then the dual active-set method."""

import numpy as np
import quadprog

from slot_core.arrays import Array
from slot_core.mpc.model import INPUTS, HorizonQp

STAGE = INPUTS + 12


def optimum(qp: HorizonQp) -> Array:
    """Optimal forces (H, 4, 3), N, by the method of Goldfarb and Idnani (quadprog).

    Forces with equal bounds are eliminated, because the method needs independent constraints.
    """
    size = qp.horizon * STAGE
    place = np.arange(size).reshape(qp.horizon, STAGE)
    inputs, states = place[:, :INPUTS].ravel(), place[:, INPUTS:].ravel()
    a, p = qp.A.toarray(), qp.P.toarray()
    through, offset = np.zeros((size, len(inputs))), np.zeros(size)
    through[inputs] = np.eye(len(inputs))
    through[states] = -np.linalg.solve(a[:, states], a[:, inputs])
    offset[states] = np.linalg.solve(a[:, states], qp.b.ravel())
    hessian = through.T @ p @ through
    slope = through.T @ (p @ offset + qp.c)
    return _minimum(qp, hessian, slope, inputs).reshape(qp.horizon, 4, 3)


def _minimum(qp: HorizonQp, hessian: Array, slope: Array, inputs: Array) -> Array:
    upper = qp.upper.ravel()[inputs]
    height = upper.reshape(-1, 3)[:, 2]
    free = np.repeat(height > 0.0, 3)
    f = np.zeros(len(inputs))
    if not free.any():
        return f
    normal = np.isfinite(upper)
    unit = np.eye(len(inputs))[normal]
    rows = np.vstack([-qp.G.toarray()[:, inputs], unit, -unit])
    least = np.concatenate([-qp.h, np.zeros(len(unit)), -upper[normal]])
    rows = rows[:, free]
    used = np.abs(rows).sum(axis=1) > 0.0
    square = hessian[np.ix_(free, free)]
    square = (square + square.T) / 2
    f[free] = quadprog.solve_qp(square, -slope[free], rows[used].T.copy(), least[used])[
        0
    ]
    return f
