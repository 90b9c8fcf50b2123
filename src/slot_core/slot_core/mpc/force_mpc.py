"""Convex MPC: the policy that solves one quadratic programme per tick.

It plans ground reaction forces (`force_problem.py`) and checks the inputs and the solution. A
cycle without an accepted solution returns the last feasible forces, decayed towards the gait's.
After `fallback.cycles` such cycles in a row the status is STOPPED until a solution is accepted
again.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.control.force_map import INCREMENTAL
from slot_core.control.policy import (
    PlanReport,
    Policy,
    Status,
    TendonPlan,
    Timer,
    preview_fault,
    state_fault,
    time_fault,
)
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitPreview
from slot_core.key_frame import StateParts
from slot_core.mpc.force_problem import ForceProblem, Solution
from slot_core.mpc.model import FEET, FirstStage
from slot_core.mpc.settings import MpcSettings, read_mpc
from slot_core.robot import GRAVITY, RobotParameters

NO_REPORT = PlanReport()
_NONE = np.zeros(FEET)
NO_STAGE = FirstStage(_NONE, _NONE, np.zeros((FEET, 3)), _NONE)


class ForceMpc(Policy):
    """The MPC. `step` raises nothing for bad data; the solver's iterations are limited."""

    STATE = StateParts("_stage", "_last", "_missed", values=(FirstStage,))

    def __init__(
        self, robot: RobotParameters, settings: MpcSettings, timer: Timer
    ):
        """Set up problem and solver; `timer` returns seconds."""
        self._robot, self._settings, self._timer = robot, settings, timer
        self.reset()

    @staticmethod
    def read_settings(name: str) -> MpcSettings:
        """`config/mpc.yaml`; raises ConfigError."""
        return read_mpc()

    def make_problem(self) -> Any:
        """The problem on forces; another one has the methods of `ForceProblem`."""
        return ForceProblem(self._robot, self._settings)

    def reset(self) -> None:
        """Set up the problem afresh, without an earlier input."""
        self.problem = self.make_problem()  # of the last step
        self._stage = NO_STAGE
        # last feasible input of the first stage minus u_ref
        self._last: Array | None = None
        self._missed = 0  # consecutive cycles without an accepted solution

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """Plan for the estimate at stage 0 of `preview`.

        A solution is accepted if it is solved, finite, within `violation_max` and `time_budget`.
        """
        start, state = self._timer(), estimate.state
        most = self._settings.acceptance.input_max
        if fault := preview_fault(preview, self._settings.horizon, most):
            self._stage = replace(self._stage, rate=np.zeros(FEET))
            return self._fall_back(Status.REJECTED, fault)
        self._stage = self.problem.read(preview)
        if fault := state_fault(state, most):
            return self._fall_back(Status.REJECTED, fault)
        self.problem.update(np.asarray(state, dtype=float), preview)
        return self._accept(self.problem.solve(), start)

    def _accept(self, solution: Solution, start: float) -> TendonPlan:
        """The solution's plan if it is accepted, else the fallback's; `start`: of the tick, s."""
        limits, problem, z = (
            self._settings.acceptance,
            self.problem,
            solution.z,
        )
        violation = problem.violation(z)
        report = PlanReport(
            cost=problem.cost(z),
            iterations=solution.iterations,
            violation=violation,
            residual=problem.residual(z),
        )
        force, elapsed = problem.forces(z), self._timer() - start
        fault = solution.fault
        if not fault and not np.isfinite(z).all():
            fault = "solution not finite"
        if not fault and violation > limits.violation_max:
            fault = f"violation {violation:.2g} N exceeds {limits.violation_max:g} N"
        if fault:
            return self._fall_back(Status.NOT_SOLVED, fault, report)
        if fault := time_fault(elapsed, limits.time_budget):
            return self._fall_back(Status.LATE, fault, report)
        self._last, self._missed = force[0] - self._stage.force_ref, 0
        return self._plan(force, Status.SOLVED, "", report)

    def _fall_back(
        self, cause: Status, fault: str, report: PlanReport = NO_REPORT
    ) -> TendonPlan:
        """The last feasible input, decayed; nothing without one or after `fallback.cycles`."""
        self._missed += 1
        rule = self._settings.fallback
        if self._last is None or self._missed > rule.cycles:
            used_up = f"fallback used up after {rule.cycles} cycles"
            why = "no feasible input yet" if self._last is None else used_up
            return self._plan(
                np.zeros((self._settings.horizon, FEET, 3)),
                Status.STOPPED,
                f"{why}; {fault}",
                report,
            )
        deviation = self._last
        for _ in range(self._missed):
            deviation = rule.decay * deviation
        force = self._stage.clip(self._stage.force_ref + deviation)
        return self._plan(
            np.tile(force, (self._settings.horizon, 1, 1)), cause, fault, report
        )

    def _plan(
        self, force: Array, status: Status, message: str, report: PlanReport
    ) -> TendonPlan:
        """The plan with the slacks of its first stage; report: of the solver."""
        stage, first = self._stage, force[0]
        above_least, below_max, friction = stage.slacks(first)
        return TendonPlan(
            angle=np.zeros((0, FEET)),
            rate=stage.rate,
            force=force,
            status=status,
            message=message,
            map=INCREMENTAL,
            fallback_cycles=self._missed,
            report=replace(
                report,
                slack_normal_min=above_least,
                slack_normal_max=below_max,
                slack_friction=friction,
                slack_total=float(
                    stage.force_max.sum() - self.problem.mass * GRAVITY
                ),
                slack_balance=self.problem.balance(first),
                mass=self.problem.mass,
            ),
        )
