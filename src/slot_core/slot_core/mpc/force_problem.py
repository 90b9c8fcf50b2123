"""Problem of the MPC on ground reaction forces: torso model, quadratic programme and solver.

The paper's formulation, made well posed, for comparison. It takes the legs as ideal sources of
force (`model.py`), which soft legs are not. As printed and as published: `paper_problem.py`.
"""

from __future__ import annotations

import math

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.control.input_check import STAGE
from slot_core.gait.gait import GaitPreview
from slot_core.mpc.model import (
    FEET,
    FirstStage,
    Horizon,
    HorizonQp,
    Prediction,
    TorsoModel,
    condensed_condition,
)
from slot_core.mpc.settings import MpcSettings
from slot_core.mpc.solver import QpSolver, Solution
from slot_core.robot import RobotParameters


class ForceProblem:
    """The problem with the values of the present tick, and its solver, which starts cold."""

    def __init__(self, robot: RobotParameters, settings: MpcSettings):
        """Set up problem and solver.

        Raises ConfigError if the weights leave the problem ill-conditioned.
        """
        self._settings, self.mass = settings, robot.mass
        self._model = TorsoModel(robot)
        weights, horizon = settings.weights, settings.horizon
        generic = self._model.predict(0.3, 0.1, STAGE[1])
        _check_condition(generic, settings)
        self.qp = HorizonQp(weights.q, weights.r, horizon, generic)
        self._solver = QpSolver(self.qp, settings.solver)
        self._solver.solve()  # the first solve is slow (page faults): not during operation
        self._ahead: Horizon | None = None

    def read(self, preview: GaitPreview) -> FirstStage:
        """Take the limits and targets of a preview; returns those of its first stage.

        If the preview ends with stage H-1, its reference there is the target of state H too.
        """
        now = np.arange(self._settings.horizon)
        following = np.minimum(now + 1, len(preview.reference) - 1)
        force = np.zeros((len(now), FEET, 3))
        force[..., 2] = np.asarray(preview.normal_force)[now]
        contact = np.asarray(preview.contact, dtype=float)[now]
        self._ahead = ahead = Horizon(
            force_max=self._settings.force_max * contact,
            friction=np.asarray(preview.friction, dtype=float)[now],
            force_ref=force,
            state_ref=np.asarray(preview.reference, dtype=float)[following],
        )
        return FirstStage(ahead.force_max[0], ahead.friction[0], force[0], preview.rate)

    def update(self, state: Array, preview: GaitPreview) -> None:
        """Set the present state (12,), at stage 0 of the preview that was read."""
        assert self._ahead is not None
        prediction = self._model.predict(state[2], state[5], preview.dt)
        self.qp.update(prediction, state, self._ahead)

    def solve(self) -> Solution:
        """Solve the problem with its present values; raises nothing."""
        return self._solver.solve()

    def balance(self, force: Array) -> float:
        """Slack of the balance of forces (4, 3) with the weight: infinite, without such a limit."""
        return math.inf

    def forces(self, z: Array) -> Array:
        """Forces (H, 4, 3) N at z."""
        return self.qp.forces(z)

    def cost(self, z: Array) -> float:
        """Objective at z."""
        return self.qp.cost(z)

    def violation(self, z: Array) -> float:
        """Largest violation of a limit, N."""
        return self.qp.violation(z)

    def residual(self, z: Array) -> float:
        """Largest error of the dynamics."""
        return self.qp.residual(z)


def _check_condition(prediction: Prediction, settings: MpcSettings) -> None:
    """Raise ConfigError if the condensed Hessian is ill-conditioned."""
    weights, limit = settings.weights, settings.acceptance.condition_max
    condition = condensed_condition(prediction, weights.q, weights.r, settings.horizon)
    if not condition <= limit:
        raise config.ConfigError(
            f"mpc.yaml: weights.force = {list(weights.force)}: condition number {condition:.1e} "
            f"of the condensed Hessian exceeds {limit:.1e}, the forces are ill-conditioned; "
            "raise weights.force or lower the others"
        )
