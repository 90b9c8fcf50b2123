"""Convex MPC: settings and controller. It solves one quadratic programme per tick.

The problem is on the tendon angles (`posture_problem.py`, the default) or, as in the paper, on the
ground reaction forces (`force_problem.py`). The controller checks the inputs and the solution. A
cycle without an accepted solution returns the last feasible input, decayed towards the gait's
normal forces. After `fallback.cycles` such cycles in a row the forces are zero and the status is
STOPPED until a solution is accepted again.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from slot_core import config
from slot_core.config import choice, quantity
from slot_core.gait.gait import GaitPreview, Vector3
from slot_core.mpc.disturbance import DisturbanceSettings
from slot_core.mpc.force_map import read_springs
from slot_core.mpc.force_problem import ForceProblem
from slot_core.mpc.model import FEET, STATES, Horizon, ModelOptions, slacks
from slot_core.mpc.posture_problem import PostureOptions, PostureProblem
from slot_core.mpc.solver import MpcSolverSettings, Solution
from slot_core.robot import GRAVITY, Array, Robot

DEFAULT_PROFILE = "default"  # profile: config/mpc.yaml without changes


class Status(enum.IntEnum):
    """How a cycle ended; the numbers are those of slot_msgs/msg/GroundReactionForces."""

    SOLVED = 0
    NOT_SOLVED = 1  # infeasible, inaccurate or iteration limit: fallback in use
    LATE = 2  # solved after its time budget: fallback in use
    REJECTED = 3  # input rejected before the solve: fallback in use
    STOPPED = 4  # no feasible input yet, or fallback used up: zero forces, not to be applied


@dataclass(frozen=True)
class Weights:
    """Diagonals of Q (per squared rad, m, rad/s, m/s) and R (per squared N), axes x, y, z."""

    angle: Vector3 = quantity("roll, pitch, yaw", "1/rad^2", 0, 1e9)
    position: Vector3 = quantity("position", "1/m^2", 0, 1e9)
    rate: Vector3 = quantity("angular velocity", "s^2/rad^2", 0, 1e9)
    velocity: Vector3 = quantity("velocity", "s^2/m^2", 0, 1e9)
    force: Vector3 = quantity("deviation from the reference force, every leg", "1/N^2", 1e-12, 1e9)

    @property
    def q(self) -> Array:
        """(12,) diagonal of Q."""
        return np.concatenate([self.angle, self.position, self.rate, self.velocity])

    @property
    def r(self) -> Array:
        """(12,) diagonal of R."""
        return np.tile(self.force, FEET)


@dataclass(frozen=True)
class Acceptance:
    """Limits of the inputs and of an accepted solution."""

    violation_max: float = quantity("largest violation of a force limit", "N", 0, 1)
    time_budget: float = quantity("time for checks, update and solve", "s", 0, math.inf)
    condition_max: float = quantity("condition number of the Hessian, longest stage", "", 1, 1e12)
    stage: tuple[float, float] = quantity("shortest and longest stage", "s", 1e-4, 1)
    input_max: float = quantity("largest magnitude of any input, SI units", "", 1, 1e9)


@dataclass(frozen=True)
class Fallback:
    """Fallback without a solution: u = u_ref + decay^n (u_last - u_ref) in its n-th cycle."""

    cycles: int = quantity("largest number of cycles in a row", "", 0, 1000)
    decay: float = quantity("factor per cycle", "", 0, 1)


@dataclass(frozen=True)
class MpcSettings:
    """Settings of `config/mpc.yaml`."""

    posture: PostureOptions
    weights: Weights
    model: ModelOptions
    disturbance: DisturbanceSettings
    solver: MpcSolverSettings
    acceptance: Acceptance
    fallback: Fallback
    problem: str = choice("inputs of the problem", "tendons", "forces")
    map: str = choice("force map that belongs to it", "springs", "incremental", "paper")
    horizon: int = quantity("stages", "", 1, 100)
    force_max: float = quantity("largest normal force of a leg", "N", 0, 100)

    def __post_init__(self) -> None:
        """Raise ConfigError for a problem on tendon angles without the gait's forces."""
        if self.problem == "tendons" and self.model.reference != "gait":
            raise config.ConfigError(
                f"model.reference = {self.model.reference!r}: problem tendons corrects the gait's"
                " forces, expected 'gait'"
            )


@dataclass(frozen=True)
class MpcResult:
    """Forces and solver report; meanings as in slot_msgs/msg/GroundReactionForces."""

    force: Array  # (4, 3) N, in odom
    status: Status
    message: str  # one line, empty if SOLVED
    fallback_cycles: int  # consecutive cycles without an accepted solution
    cost: float  # of the solver's solution; NaN if it was not called
    iterations: int
    solve_time: float  # s, for check, update and solve
    violation: float  # N, largest over the horizon; NaN if the solver was not called
    residual: float  # SI, largest error of the dynamics; NaN if the solver was not called
    slack_normal_min: Array  # (4,) N, first stage of `force`
    slack_normal_max: Array  # (4,) N
    slack_friction: Array  # (4,) N
    slack_total: float  # N, sum of contact f_max - m g
    slack_balance: float  # N, band - |sum f_z - m g|; infinite without `equality`
    mass: float  # kg, of the model


@dataclass(frozen=True)
class _SolverReport:
    """Time of a cycle and quality of the solver's solution, accepted or not."""

    elapsed: float  # s
    iterations: int
    violation: float  # N
    residual: float
    cost: float


@dataclass(frozen=True)
class _FirstStage:
    """Limits and reference forces of stage 0 of the newest valid preview."""

    force_max: Array  # (4,) N
    friction: Array  # (4,)
    force_ref: Array  # (4, 3) N

    def clip(self, force: Array) -> Array:
        """Forces (4, 3) N clipped to the limits, the normal forces first."""
        normal = np.clip(force[:, 2:], 0.0, self.force_max[:, None])
        limit = self.friction[:, None] * normal
        return np.hstack([np.clip(force[:, :2], -limit, limit), normal])


class Mpc:
    """The controller. `step` raises nothing for bad data; the solver's iterations are limited."""

    def __init__(self, robot: Robot, settings: MpcSettings, timer: Callable[[], float]):
        """Set up problem and solver; `timer` returns seconds.

        Raises ConfigError if the weights leave the problem ill-conditioned, or if the solver does
        not cover the options of the model.
        """
        self._settings, self._timer, self._weight = settings, timer, robot.weight
        self._problem: PostureProblem | ForceProblem
        if settings.problem == "forces":
            self._problem = ForceProblem(robot, settings)
        else:
            self._problem = PostureProblem(
                robot, read_springs(), settings.posture, settings.horizon
            )
        self._stage = _FirstStage(np.zeros(FEET), np.zeros(FEET), np.zeros((FEET, 3)))
        self._last: Array | None = None  # (4, 3) N, last feasible input
        self._missed = 0  # consecutive cycles without an accepted solution

    @property
    def problem(self) -> PostureProblem | ForceProblem:
        """The problem of the last step; read only."""
        return self._problem

    def step(self, state: Array, preview: GaitPreview) -> MpcResult:
        """Forces for `state` (12,) at stage 0 of `preview`.

        If the preview ends with stage H-1, its reference there is the target of state H too. A
        solution is accepted if it is solved, finite, within `violation_max` and `time_budget`.
        """
        start = self._timer()
        if fault := _preview_fault(preview, self._settings):
            return self._reject(fault, start)
        stages = self._read(preview)
        self._stage = _FirstStage(stages.force_max[0], stages.friction[0], stages.force_ref[0])
        if fault := _state_fault(state, self._settings):
            return self._reject(fault, start)
        x = np.asarray(state, dtype=float)
        self._problem.update(x, preview, stages)
        result = self._accept(self._problem.solve(), self._timer() - start)
        if result.status is not Status.STOPPED:  # else the last angles are held
            self._problem.follow(result.force)
        return result

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

    def _reject(self, fault: str, start: float) -> MpcResult:
        report = _SolverReport(self._timer() - start, 0, math.nan, math.nan, math.nan)
        return self._fall_back(Status.REJECTED, fault, report)

    def _accept(self, solution: Solution, elapsed: float) -> MpcResult:
        """The solution's forces if it is accepted, else the fallback's."""
        limits, qp, z = self._settings.acceptance, self._problem, solution.z
        force, violation = qp.forces(z), qp.violation(z)
        report = _SolverReport(elapsed, solution.iterations, violation, qp.residual(z), qp.cost(z))
        if solution.fault:
            return self._fall_back(Status.NOT_SOLVED, solution.fault, report)
        if not np.isfinite(solution.z).all():
            return self._fall_back(Status.NOT_SOLVED, "solution not finite", report)
        if violation > limits.violation_max:
            fault = f"violation {violation:.2g} N exceeds {limits.violation_max:g} N"
            return self._fall_back(Status.NOT_SOLVED, fault, report)
        if elapsed > limits.time_budget:
            fault = f"{elapsed * 1e3:.1f} ms exceed {limits.time_budget * 1e3:g} ms"
            return self._fall_back(Status.LATE, fault, report)
        self._last, self._missed = force[0].copy(), 0
        return self._result(force[0], Status.SOLVED, "", report)

    def _fall_back(self, cause: Status, fault: str, report: _SolverReport) -> MpcResult:
        """The last feasible input, decayed; zero without one or after `fallback.cycles`."""
        self._missed += 1
        rule = self._settings.fallback
        if self._last is None or self._missed > rule.cycles:
            used_up = f"fallback used up after {rule.cycles} cycles"
            why = "no feasible input yet" if self._last is None else used_up
            return self._result(np.zeros((FEET, 3)), Status.STOPPED, f"{why}; {fault}", report)
        reference = self._stage.force_ref
        force = reference + rule.decay**self._missed * (self._last - reference)
        return self._result(self._stage.clip(force), cause, fault, report)

    def _result(
        self, force: Array, status: Status, message: str, report: _SolverReport
    ) -> MpcResult:
        stage = self._stage
        above_zero, below_max, friction = slacks(force, stage.force_max, stage.friction)
        weight, balance = self._problem.mass * GRAVITY, math.inf
        if self._settings.model.support == "equality":
            balance = self._settings.model.support_band - abs(float(force[:, 2].sum()) - weight)
        return MpcResult(
            force=force,
            status=status,
            message=message,
            fallback_cycles=self._missed,
            cost=report.cost,
            iterations=report.iterations,
            solve_time=report.elapsed,
            violation=report.violation,
            residual=report.residual,
            slack_normal_min=above_zero,
            slack_normal_max=below_max,
            slack_friction=friction,
            slack_total=float(stage.force_max.sum() - weight),
            slack_balance=balance,
            mass=self._problem.mass,
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


def read_mpc(profile: str = DEFAULT_PROFILE) -> MpcSettings:
    """The settings of `config/mpc.yaml`, changed by a profile; raises ConfigError.

    A profile `config/mpc/<name>.yaml` holds only the changed values, by dotted name.
    """
    settings = config.read(MpcSettings, "mpc")
    if profile == DEFAULT_PROFILE:
        return settings
    return config.replace(settings, config.load(f"mpc/{profile}"), f"mpc/{profile}.yaml")
