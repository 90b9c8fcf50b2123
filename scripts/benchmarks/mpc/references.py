"""Reference solutions of the MPC's problem, far too slow for control.

`optimum`: the exact one by a dual active-set method, states eliminated. `restated`: the paper's way,
the problem built anew in CVXPY in every cycle.
"""

import cvxpy as cp
import numpy as np
import quadprog

from slot_core.arrays import Array
from slot_core.gait.gait import GaitPreview
from slot_core.mpc.force_problem import ForceProblem
from slot_core.mpc.model import FEET, INPUTS, STAGE, STATES, TorsoModel
from slot_core.mpc.settings import MpcSettings
from slot_core.robot import RobotParameters


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


def restated(
    robot: RobotParameters,
    settings: MpcSettings,
    state: Array,
    preview: GaitPreview,
) -> Array:
    """Optimal forces (H, 4, 3), N, by SCS as in the paper; the problem is built anew."""
    stages = settings.horizon
    model = TorsoModel(robot).predict(state[2], state[5], preview.dt)
    q, r = np.diag(settings.weights.q), np.diag(settings.weights.r)
    x, u = cp.Variable((STATES, stages + 1)), cp.Variable((INPUTS, stages))
    cost, constraints = 0, [x[:, 0] == state]
    for k in range(stages):
        u_ref = np.zeros(INPUTS)
        u_ref[2::3] = preview.normal_force[k]
        cost += cp.quad_form(x[:, k + 1] - preview.reference[k + 1], q)
        cost += cp.quad_form(u[:, k] - u_ref, r)
        constraints.append(
            x[:, k + 1] == model.a @ x[:, k] + model.b @ u[:, k] + model.drift
        )
        for leg in range(FEET):
            f_x, f_y, f_z = (u[3 * leg + axis, k] for axis in range(3))
            friction = preview.friction[k][leg] * f_z
            f_max = settings.force_max * preview.contact[k][leg]
            constraints += [f_z >= 0, f_z <= f_max]
            constraints += [cp.abs(f_x) <= friction, cp.abs(f_y) <= friction]
    cp.Problem(cp.Minimize(cost), constraints).solve(solver=cp.SCS)
    return u.value.T.reshape(stages, FEET, 3)
