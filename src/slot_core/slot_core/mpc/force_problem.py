"""Problem of the MPC on ground reaction forces: torso model, disturbance observer and solver.

The paper's formulation, for comparison. It takes the legs as ideal sources of force (`model.py`),
which soft legs are not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slot_core import config
from slot_core.clock import to_seconds
from slot_core.control.input_check import STAGE
from slot_core.control.policy import TendonPlan
from slot_core.gait.gait import GaitPreview
from slot_core.mpc.disturbance import Disturbance
from slot_core.mpc.model import (
    Horizon,
    HorizonQp,
    Prediction,
    TorsoModel,
    condensed_condition,
)
from slot_core.mpc.settings import MpcSettings
from slot_core.mpc.solver import Solution, make_solver
from slot_core.robot import GRAVITY, Array, RobotParameters

LONGEST_GAP = 0.5  # s between ticks; after a longer one the acting forces are unknown


@dataclass(frozen=True)
class _LastTick:
    """The last tick whose input was not rejected."""

    stamp: int  # ns
    state: Array  # (12,)
    force: Array  # (4, 3) N, requested


class ForceProblem:
    """The problem with the values of the present tick, its observer and its solver."""

    def __init__(self, robot: RobotParameters, settings: MpcSettings):
        """Set up problem and solver.

        Raises ConfigError if the weights leave the problem ill-conditioned.
        """
        self._settings, self._mass = settings, robot.mass
        self._model = TorsoModel(robot)
        self._disturbance = Disturbance(robot.mass, settings.disturbance)
        weights, horizon = settings.weights, settings.horizon
        generic = self._model.predict(0.3, 0.1, STAGE[1])
        _check_condition(generic, settings)
        self.qp = HorizonQp(weights.q, weights.r, horizon, generic, settings.model, robot.weight)
        self._solver = make_solver(self.qp, settings.solver)
        self._solver.solve()  # the first solve is slow (page faults): not during operation
        self._stamp, self._state = 0, np.zeros(12)
        self._last: _LastTick | None = None

    @property
    def mass(self) -> float:
        """Mass of the model, kg."""
        return self._disturbance.mass

    @property
    def share(self) -> float:
        """Estimated mass over the robot's nominal mass; scales the reference forces."""
        return self._disturbance.mass / self._mass

    def update(self, state: Array, preview: GaitPreview, ahead: Horizon) -> None:
        """Set the present state (12,), the preview and the limits and targets ahead."""
        self._observe(state, preview.stamp)
        self._stamp, self._state = preview.stamp, state
        mass, bias = self._disturbance.mass, self._disturbance.bias
        prediction = self._model.predict(state[2], state[5], preview.dt, mass, bias)
        self.qp.update(prediction, state, ahead, mass * GRAVITY)

    def solve(self) -> Solution:
        """Solve the problem with its present values; raises nothing."""
        return self._solver.solve()

    def follow(self, plan: TendonPlan) -> None:
        """Take the plan that the legs are commanded from this tick on."""
        self._last = _LastTick(self._stamp, self._state, plan.force[0])

    def cost(self, z: Array) -> float:
        """Objective at z."""
        return self.qp.cost(z)

    def violation(self, z: Array) -> float:
        """Largest violation of a limit, N."""
        return self.qp.violation(z)

    def residual(self, z: Array) -> float:
        """Largest error of the dynamics."""
        return self.qp.residual(z)

    def _observe(self, state: Array, stamp: int) -> None:
        """Update the disturbance observer, if it is on, with the state after the last tick."""
        last = self._last
        if last is None or self._settings.disturbance.time == 0.0:
            return
        dt = to_seconds(stamp - last.stamp)
        if not 0.0 < dt <= LONGEST_GAP:
            return
        disturbance = self._disturbance
        model = self._model.predict(
            last.state[2], last.state[5], dt, disturbance.mass, disturbance.bias
        )
        predicted = model.a @ last.state + model.b @ last.force.ravel() + model.drift
        disturbance.correct(predicted[6:], state[6:], dt)


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
