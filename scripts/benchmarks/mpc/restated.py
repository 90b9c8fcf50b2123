"""The MPC in CVXPY with SCS as in the paper: the problem is rebuilt in every cycle."""

import cvxpy
import numpy as np

from slot_core.gait.gait import GaitPreview
from slot_core.mpc.model import FEET, INPUTS, STATES, TorsoModel
from slot_core.mpc.settings import MpcSettings
from slot_core.robot import Array, RobotParameters


def restated(
    robot: RobotParameters, settings: MpcSettings, state: Array, preview: GaitPreview
) -> Array:
    """Optimal forces (H, 4, 3), N, by SCS, for a state (12,)."""
    stages = settings.horizon
    model = TorsoModel(robot).predict(state[2], state[5], preview.dt)
    q, r = np.diag(settings.weights.q), np.diag(settings.weights.r)
    x, u = cvxpy.Variable((STATES, stages + 1)), cvxpy.Variable((INPUTS, stages))
    cost, constraints = 0, [x[:, 0] == state]
    for k in range(stages):
        u_ref = np.zeros(INPUTS)
        u_ref[2::3] = preview.normal_force[k]
        cost += cvxpy.quad_form(x[:, k + 1] - preview.reference[k + 1], q)
        cost += cvxpy.quad_form(u[:, k] - u_ref, r)
        constraints.append(x[:, k + 1] == model.a @ x[:, k] + model.b @ u[:, k] + model.drift)
        for leg in range(FEET):
            f_x, f_y, f_z = (u[3 * leg + axis, k] for axis in range(3))
            friction = preview.friction[k][leg] * f_z
            f_max = settings.force_max * preview.contact[k][leg]
            constraints += [f_z >= 0, f_z <= f_max]
            constraints += [cvxpy.abs(f_x) <= friction, cvxpy.abs(f_y) <= friction]
    cvxpy.Problem(cvxpy.Minimize(cost), constraints).solve(solver=cvxpy.SCS)
    force: Array = u.value.T.reshape(stages, FEET, 3)
    return force
