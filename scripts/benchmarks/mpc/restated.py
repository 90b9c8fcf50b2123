"""The MPC as tutorials use CVXPY, and the paper: stated anew in every cycle, for SCS."""

import cvxpy
import numpy as np

from slot_core.control.gait import GaitPreview
from slot_core.control.mpc.model import FEET, INPUTS, STATES, TorsoModel
from slot_core.control.mpc.mpc import MpcSettings
from slot_core.robot import Array, Robot


def restated(robot: Robot, settings: MpcSettings, state: Array, preview: GaitPreview) -> Array:
    """(H, 4, 3) N."""
    stages = settings.horizon
    model = TorsoModel(robot).predict(state[2], state[5], preview.dt)
    q, r = np.diag(settings.weights.q), np.diag(settings.weights.r)
    x, u = cvxpy.Variable((STATES, stages + 1)), cvxpy.Variable((INPUTS, stages))
    cost, rules = 0, [x[:, 0] == state]
    for k in range(stages):
        u_ref = np.zeros(INPUTS)
        u_ref[2::3] = preview.normal_force[k]
        cost += cvxpy.quad_form(x[:, k + 1] - preview.reference[k + 1], q)
        cost += cvxpy.quad_form(u[:, k] - u_ref, r)
        rules.append(x[:, k + 1] == model.a @ x[:, k] + model.b @ u[:, k] + model.drift)
        for leg in range(FEET):
            f_x, f_y, f_z = (u[3 * leg + axis, k] for axis in range(3))
            most = preview.friction[k][leg] * f_z
            top = settings.force_max * preview.contact[k][leg]
            rules += [f_z >= 0, f_z <= top, cvxpy.abs(f_x) <= most, cvxpy.abs(f_y) <= most]
    cvxpy.Problem(cvxpy.Minimize(cost), rules).solve(solver=cvxpy.SCS)
    force: Array = u.value.T.reshape(stages, FEET, 3)
    return force
