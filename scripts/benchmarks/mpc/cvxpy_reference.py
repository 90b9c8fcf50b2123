"""Reference formulation of the MPC's problem in CVXPY, to check the solvers, and the paper's way.

It covers the problem without options and is far too slow for control. The parameters follow the
rules of disciplined parametrised programming (Agrawal et al., 2019), so that CVXPY compiles the
problem once; with a product of parameters, or a quadratic form of one, it would do so every time.
"""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np

from slot_core.arrays import Array
from slot_core.gait.gait import GaitPreview
from slot_core.mpc.model import FEET, INPUTS, STATES, YAW, TorsoModel
from slot_core.mpc.settings import MpcSettings
from slot_core.robot import RobotParameters

TOLERANCES = {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11}


class CvxpyReference:
    """min sum (x - x_ref)' Q (x - x_ref) + (u - u_ref)' R (u - u_ref) within the limits."""

    def __init__(self, robot: RobotParameters, settings: MpcSettings):
        """Set up the problem."""
        self._model, self._settings = TorsoModel(robot), settings
        stages = settings.horizon
        self.x0, self.drift = cp.Parameter(STATES), cp.Parameter(STATES)
        self.a, self.b = cp.Parameter((STATES, STATES)), cp.Parameter((STATES, INPUTS))
        self.x_ref, self.u_ref = (
            cp.Parameter((stages, STATES)),
            cp.Parameter((stages, INPUTS)),
        )
        self.friction = cp.Parameter((stages, FEET), nonneg=True)
        self.limit = cp.Parameter((stages, FEET), nonneg=True)
        self.u, self.x = (
            cp.Variable((stages, INPUTS)),
            cp.Variable((stages + 1, STATES)),
        )
        self._problem = cp.Problem(
            cp.Minimize(self._cost()), [*self._dynamics(), *self._limits()]
        )

    def _cost(self) -> Any:
        """Sum of squares of the errors, scaled by the roots of the weights."""
        weights = self._settings.weights
        state = (self.x[1:] - self.x_ref) @ np.diag(np.sqrt(weights.q))
        force = (self.u - self.u_ref) @ np.diag(np.sqrt(weights.r))
        return cp.sum_squares(state) + cp.sum_squares(force)

    def _dynamics(self) -> list[Any]:
        steps = [
            self.x[k + 1] == self.a @ self.x[k] + self.b @ self.u[k] + self.drift
            for k in range(self._settings.horizon)
        ]
        return [self.x[0] == self.x0, *steps]

    def _limits(self) -> list[Any]:
        f_x, f_y, f_z = self.u[:, 0::3], self.u[:, 1::3], self.u[:, 2::3]
        largest = cp.multiply(self.friction, f_z)
        pyramid = [cp.abs(f_x) <= largest, cp.abs(f_y) <= largest]
        return [f_z >= 0, f_z <= self.limit, *pyramid]

    def solve(self, state: Array, preview: GaitPreview) -> Array:
        """Optimal forces (H, 4, 3) N for a state (12,), by Clarabel."""
        self._set_parameters(state, preview)
        self._problem.solve(solver=cp.CLARABEL, **TOLERANCES)
        assert self._problem.status == cp.OPTIMAL
        return self.u.value.reshape(-1, FEET, 3)

    def _set_parameters(self, state: Array, preview: GaitPreview) -> None:
        now = np.arange(self._settings.horizon)
        prediction = self._model.predict(state[2], state[5], preview.dt)
        self.x0.value, self.a.value, self.b.value = state, prediction.a, prediction.b
        self.drift.value = prediction.drift
        following = np.minimum(now + 1, len(preview.reference) - 1)
        target = np.array(preview.reference, dtype=float)[following]
        target[:, YAW] += (
            2 * np.pi * np.round((state[YAW] - target[0, YAW]) / (2 * np.pi))
        )
        self.x_ref.value = target
        force = np.zeros((len(now), INPUTS))
        force[:, 2::3] = np.asarray(preview.normal_force)[now]
        self.u_ref.value = force
        self.friction.value = np.asarray(preview.friction, dtype=float)[now]
        contact = np.asarray(preview.contact, dtype=float)[now]
        self.limit.value = self._settings.force_max * contact


def restated(
    robot: RobotParameters, settings: MpcSettings, state: Array, preview: GaitPreview
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
