"""The exact optimum of a `ForceProblem`: states eliminated, then the dual active-set method."""

import numpy as np
import quadprog

from slot_core.arrays import Array
from slot_core.mpc.force_problem import ForceProblem
from slot_core.mpc.model import FEET, INPUTS, STAGE, STATES


def optimum(problem: ForceProblem) -> Array:
    """Optimal forces (H, 4, 3), N, by the method of Goldfarb and Idnani (quadprog).

    Forces with equal bounds are eliminated, because the method needs independent constraints.
    """
    n = problem.horizon
    place = np.arange(n * STAGE).reshape(n, STAGE)
    inputs, states = place[:, :INPUTS].ravel(), place[:, INPUTS:].ravel()
    rows = problem.matrix.toarray()
    a, p = rows[: n * STATES], np.diag(problem.weight)
    through, offset = np.zeros((n * STAGE, n * INPUTS)), np.zeros(n * STAGE)
    through[inputs] = np.eye(len(inputs))
    through[states] = -np.linalg.solve(a[:, states], a[:, inputs])
    offset[states] = np.linalg.solve(a[:, states], problem.right[: n * STATES])
    hessian = through.T @ p @ through
    slope = through.T @ (p @ offset + problem.c)
    limits = -rows[n * STATES :, inputs], -problem.right[n * STATES :]
    free = np.repeat(problem.right[-n * FEET :] > 0.0, 3)  # may carry a force
    return _minimum(hessian, slope, *limits, free).reshape(n, FEET, 3)


def _minimum(
    hessian: Array, slope: Array, rows: Array, least: Array, free: Array
) -> Array:
    """Minimum of f' hessian f / 2 + slope' f with rows f >= least, zero where f is not free."""
    f = np.zeros(len(slope))
    if not free.any():
        return f
    rows = rows[:, free]
    used = np.abs(rows).sum(axis=1) > 0.0
    square = hessian[np.ix_(free, free)]
    square = (square + square.T) / 2
    limits = rows[used].T.copy(), least[used]
    f[free] = quadprog.solve_qp(square, -slope[free], *limits)[0]
    return f
