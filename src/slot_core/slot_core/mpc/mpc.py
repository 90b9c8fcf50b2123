"""Convex MPC: the policy that solves one quadratic programme per tick.

The problem is on the tendon angles (`posture_problem.py`, the default) or, as in the paper, on the
ground reaction forces (`force_problem.py`). The policy checks the inputs and the solution. A cycle
without an accepted solution returns the last feasible input, decayed towards the gait's angles or
normal forces. After `fallback.cycles` such cycles in a row the status is STOPPED until a solution
is accepted again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slot_core.control.force_map import read_springs
from slot_core.control.policy import PlanReport, Policy, Status, TendonPlan, Timer
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitPreview
from slot_core.mpc.force_problem import ForceProblem
from slot_core.mpc.model import FEET, STATES, FirstStage, Horizon, slacks
from slot_core.mpc.posture_problem import PostureProblem
from slot_core.mpc.settings import MpcSettings, read_mpc
from slot_core.mpc.solver import Solution
from slot_core.robot import GRAVITY, Array, RobotParameters

_NONE = np.zeros(FEET)
NO_STAGE = FirstStage(_NONE, _NONE, np.zeros((FEET, 3)), _NONE, _NONE)


@dataclass(frozen=True)
class _SolverReport:
    """Quality of the solver's solution, accepted or not."""

    iterations: int = 0
    violation: float = math.nan  # N
    residual: float = math.nan
    cost: float = math.nan


class Mpc(Policy):
    """The MPC. `step` raises nothing for bad data; the solver's iterations are limited."""

    def __init__(self, robot: RobotParameters, settings: MpcSettings, timer: Timer):
        """Set up problem and solver; `timer` returns seconds.

        Raises ConfigError if the weights leave the problem ill-conditioned.
        """
        self._robot, self._settings, self._timer = robot, settings, timer
        self.reset()

    @staticmethod
    def read_settings(name: str) -> MpcSettings:
        """`config/mpc.yaml`, changed by the profile of that name; raises ConfigError."""
        return read_mpc(name)

    def reset(self) -> None:
        """Set up the problem afresh, without an earlier input and without a disturbance."""
        robot, settings = self._robot, self._settings
        self._problem: PostureProblem | ForceProblem
        if settings.problem == "forces":
            self._problem = ForceProblem(robot, settings)
        else:
            self._problem = PostureProblem(
                robot, read_springs(), settings.posture, settings.horizon
            )
        self._stage = NO_STAGE
        self._last: Array | None = None  # last feasible input of the first stage minus u_ref
        self._missed = 0  # consecutive cycles without an accepted solution

    @property
    def problem(self) -> PostureProblem | ForceProblem:
        """The problem of the last step; read only."""
        return self._problem

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """Plan for the estimate at stage 0 of `preview`.

        If the preview ends with stage H-1, its reference there is the target of state H too. A
        solution is accepted if it is solved, finite, within `violation_max` and `time_budget`.
        """
        start, state = self._timer(), estimate.state
        if fault := _preview_fault(preview, self._settings):
            self._stage = replace(self._stage, rate=np.zeros(FEET))
            return self._fall_back(Status.REJECTED, fault)
        stages = self._read(preview)
        angle = np.asarray(preview.tendon_angle, dtype=float)[0]
        limits = stages.force_max[0], stages.friction[0]
        self._stage = FirstStage(*limits, stages.force_ref[0], angle, preview.rate)
        if fault := _state_fault(state, self._settings):
            return self._fall_back(Status.REJECTED, fault)
        self._problem.update(np.asarray(state, dtype=float), preview, stages)
        plan = self._accept(self._problem.solve(), start)
        if plan.status is not Status.STOPPED:  # else the last angles are held
            self._problem.follow(plan)
        return plan

    def _read(self, preview: GaitPreview) -> Horizon:
        """Limits and targets over the horizon, from the preview."""
        now = np.arange(self._settings.horizon)
        following = np.minimum(now + 1, len(preview.reference) - 1)
        force = np.zeros((len(now), FEET, 3))
        if self._settings.model.reference == "gait":
            force[..., 2] = self._problem.share * np.asarray(preview.normal_force)[now]
        return Horizon(
            force_max=self._settings.force_max * np.asarray(preview.contact, dtype=float)[now],
            friction=np.asarray(preview.friction, dtype=float)[now],
            force_ref=force,
            state_ref=np.asarray(preview.reference, dtype=float)[following],
        )

    def _accept(self, solution: Solution, start: float) -> TendonPlan:
        """The solution's plan if it is accepted, else the fallback's; `start`: of the tick, s."""
        limits, qp, z = self._settings.acceptance, self._problem, solution.z
        violation = qp.violation(z)
        report = _SolverReport(solution.iterations, violation, qp.residual(z), qp.cost(z))
        angle, force = qp.plan(z)
        elapsed = self._timer() - start
        fault = solution.fault
        if not fault and not np.isfinite(z).all():
            fault = "solution not finite"
        if not fault and violation > limits.violation_max:
            fault = f"violation {violation:.2g} N exceeds {limits.violation_max:g} N"
        if fault:
            return self._fall_back(Status.NOT_SOLVED, fault, report)
        if elapsed > limits.time_budget:
            fault = f"{elapsed * 1e3:.1f} ms exceed {limits.time_budget * 1e3:g} ms"
            return self._fall_back(Status.LATE, fault, report)
        self._last, self._missed = qp.deviation(self._stage, angle, force), 0
        return self._plan(angle, force, Status.SOLVED, "", report)

    def _fall_back(
        self, cause: Status, fault: str, report: _SolverReport = _SolverReport()
    ) -> TendonPlan:
        """The last feasible input, decayed; nothing without one or after `fallback.cycles`."""
        self._missed += 1
        rule = self._settings.fallback
        if self._last is None or self._missed > rule.cycles:
            used_up = f"fallback used up after {rule.cycles} cycles"
            why = "no feasible input yet" if self._last is None else used_up
            nothing = np.zeros((0, FEET)), np.zeros((self._settings.horizon, FEET, 3))
            return self._plan(*nothing, Status.STOPPED, f"{why}; {fault}", report)
        deviation = rule.decay**self._missed * self._last
        inputs = self._problem.fallback(self._stage, deviation)
        angle, force = (np.repeat(value, self._settings.horizon, axis=0) for value in inputs)
        return self._plan(angle, force, cause, fault, report)

    def _plan(
        self,
        angle: Array,
        force: Array,
        status: Status,
        message: str,
        report: _SolverReport,
    ) -> TendonPlan:
        """The plan with the slacks of its first stage."""
        stage, model, first = self._stage, self._settings.model, force[0]
        above_zero, below_max, friction = slacks(first, stage.force_max, stage.friction)
        weight, balance = self._problem.mass * GRAVITY, math.inf
        if model.support == "equality":
            balance = model.support_band - abs(float(first[:, 2].sum()) - weight)
        return TendonPlan(
            angle=angle,
            rate=stage.rate,
            force=force,
            status=status,
            message=message,
            map=self._settings.map if self._settings.problem == "forces" else "",
            fallback_cycles=self._missed,
            report=PlanReport(
                cost=report.cost,
                iterations=report.iterations,
                violation=report.violation,
                residual=report.residual,
                slack_normal_min=above_zero,
                slack_normal_max=below_max,
                slack_friction=friction,
                slack_total=float(stage.force_max.sum() - weight),
                slack_balance=balance,
                mass=self._problem.mass,
            ),
        )


def _state_fault(state: Array, settings: MpcSettings) -> str:
    """One line on the first invalid element, its value and its limit; empty if there is none."""
    most = settings.acceptance.input_max
    return _fault("state", state, (STATES,), -most, most)


def _preview_fault(preview: GaitPreview, settings: MpcSettings) -> str:
    """One line on the first invalid element, its value and its limit; empty if there is none."""
    most, stages = settings.acceptance.input_max, settings.horizon
    return (
        _fault("preview.dt", preview.dt, (), *settings.acceptance.stage)
        or _fault("preview.contact", preview.contact, (stages, FEET), 0, 1)
        or _fault("preview.friction", preview.friction, (stages, FEET), 0, most)
        or _fault("preview.normal_force", preview.normal_force, (stages, FEET), -most, most)
        or _fault("preview.tendon_angle", preview.tendon_angle, (stages, FEET), -most, most)
        or _fault("preview.reference", preview.reference, (stages, STATES), -most, most)
    )


def _fault(name: str, value: Any, shape: tuple[int, ...], low: float, high: float) -> str:
    """The fault of an input of `shape`, or ""; two-dimensional inputs may have more rows."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return f"{name}: not numbers"
    usable = array[: shape[0]].shape if array.ndim == len(shape) == 2 else array.shape
    if usable != shape:
        return f"{name}: shape {array.shape}, needs {shape}"
    inside = (array >= low) & (array <= high)  # false for NaN
    if inside.all():
        return ""
    index = tuple(int(i) for i in np.argwhere(~inside)[0])
    where = f"[{', '.join(map(str, index))}]" if index else ""
    return f"{name}{where} = {array[index]:g}: outside [{low:g}, {high:g}]"
