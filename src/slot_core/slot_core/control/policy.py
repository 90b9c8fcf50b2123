"""Policy: contract of a controller, from the estimated state and the gait's preview to a plan.

`mpc_controller` runs the policy that `scripts/run --policy` names and publishes its plan;
`force_mapper` makes the tendon angles of it (`force_map.py`). A user's policy is a class like the
ones of `policies.py`, named there, or in a Python file that ends with `POLICY = TheClass`. A learned
network is `onnx:FILE` (`onnx_policy.py`).

The simplest policy is `GaitAlone`, which passes on the angles and forces of the gait. `TunedPolicy`
runs a policy whose settings can be changed while the robot stands. The checks of a policy's inputs and
of its computing time give one line on the first fault.
"""

import enum
import importlib.util
import math
import pkgutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.control.effort import Effort
from slot_core.control.policies import POLICIES, RENAMED
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import STAND, GaitPreview, first_rate
from slot_core.key_frame import StateParts
from slot_core.names import ONNX
from slot_core.refusal import quoted, require_regular
from slot_core.robot import LEGS, RobotParameters

Timer = Callable[[], float]  # s


class Status(enum.IntEnum):
    """Status of a plan, with the values of slot_msgs/msg/TendonPlan."""

    SOLVED = 0
    NOT_SOLVED = 1  # infeasible, inaccurate or iteration limit: fallback in use
    LATE = 2  # solved after its time budget: fallback in use
    REJECTED = 3  # input rejected before the solve: fallback in use
    STOPPED = 4  # no feasible input yet, or fallback used up: not to be applied


def _unknown() -> Array:
    return np.full(len(LEGS), math.nan)


@dataclass(frozen=True)
class PlanReport:
    """Figures of a solve and slacks of the first stage; NaN: a policy without them."""

    cost: float = math.nan  # of the solver's solution
    iterations: int = 0
    violation: float = math.nan  # N, largest over the horizon
    residual: float = math.nan  # SI, largest error of the dynamics
    slack_normal_min: Array = field(default_factory=_unknown)  # (4,) N
    slack_normal_max: Array = field(default_factory=_unknown)  # (4,) N
    slack_friction: Array = field(default_factory=_unknown)  # (4,) N
    # (4,) rad, to the nearer limit
    slack_angle: Array = field(default_factory=_unknown)
    slack_rate: Array = field(default_factory=_unknown)  # (4,) rad/s
    slack_total: float = math.nan  # N, sum of contact f_max - m g
    # N, band - |sum f_z - m g|; infinite without `equality`
    slack_balance: float = math.nan
    mass: float = math.nan  # kg, of the model
    # v_x, v_y m/s, yaw rate rad/s
    drift: Array = field(default_factory=lambda: np.zeros(3))
    # F_z N, M_x, M_y N m
    wrench: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class TendonPlan:
    """Tendon angles and ground reaction forces over the stages 0 .. n-1; legs FL FR RL RR.

    A policy that plans forces alone leaves `angle` empty and names the map that turns the forces of
    the first stage into angles, one of `force_map.py`.
    """

    angle: Array  # (n, 4) rad, or (0, 4)
    # (4,) rad/s, rates at which the driver extrapolates the first angles until the next plan
    rate: Array
    force: Array  # (n, 4, 3) N, predicted or planned, in odom
    status: Status = Status.SOLVED
    message: str = ""  # one line, empty if SOLVED
    map: str = ""  # of a plan of forces alone
    fallback_cycles: int = 0  # consecutive cycles without an accepted solution
    report: PlanReport = PlanReport()
    # (n, 6) roll, pitch, yaw, x, y,
    pose: Array = field(default_factory=lambda: np.zeros((0, 6)))
    # z at the stages 1 .. n, predicted, in odom; empty: the policy predicts none
    # (n, 4, 3) m, there
    foot: Array = field(default_factory=lambda: np.zeros((0, len(LEGS), 3)))


@dataclass(frozen=True)
class NoSettings:
    """Settings of a policy that has none."""


class Policy(Protocol):
    """Controller of the legs; its class can derive from this one, which has all but `step`.

    STATE names what `step` depends on (`key_frame.py`). Without it a bag that begins after the
    policy did does not replay its plans. A policy that computes less where `effort`, which is set
    before `prepare`, is less than FULL names it in the message of its plans.
    """

    STATE: ClassVar[StateParts | None] = None
    effort: Effort = Effort.FULL

    def __init__(
        self, robot: RobotParameters, settings: Any, timer: Timer
    ) -> None:
        """Take the nominal robot and `read_settings`; `timer` returns seconds.

        Raises ConfigError for settings that contradict each other.
        """

    @staticmethod
    def read_settings(name: str) -> Any:
        """Frozen dataclass of `config.read`, whose values become parameters of the node.

        name: the policy's. Raises ConfigError.
        """
        return NoSettings()

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """Plan for an estimate and the preview of the same stamp; raises nothing for bad data."""

    def prepare(self) -> None:
        """Prepare the next `step` after the command has been sent."""

    def reset(self) -> None:
        """Discard what was learned from earlier estimates: time has been set back."""


def policy_class(name: str) -> type[Policy]:
    """Class of a policy, by its name in POLICIES or by its file; raises ConfigError."""
    if name.endswith(".py"):
        return _class_in_file(Path(name))
    if name.startswith(ONNX):
        place = "slot_core.control.onnx_policy:OnnxPolicy"
    elif name in POLICIES:
        place = POLICIES[name]
    elif name in RENAMED:
        raise ConfigError(
            f"policy {quoted(name)}: it is named {RENAMED[name]} now"
        )
    else:
        raise ConfigError(
            f"policy {quoted(name)}: expected one of {', '.join(POLICIES)}, a file that ends with"
            f" .py, or {ONNX}FILE"
        )
    found: type[Policy] = pkgutil.resolve_name(place)
    return found


def make_policy(
    name: str,
    robot: RobotParameters,
    timer: Timer = time.perf_counter,
    settings: Any = None,
) -> Policy:
    """The policy of that name or file, by default with its own settings; raises ConfigError."""
    kind = policy_class(name)
    return kind(
        robot, kind.read_settings(name) if settings is None else settings, timer
    )


def _class_in_file(path: Path) -> type[Policy]:
    """`POLICY` of a Python file; raises ConfigError, also for an error of the file itself."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        require_regular(path)
        spec.loader.exec_module(module)
        found: type[Policy] = module.POLICY
    except Exception as error:
        raise ConfigError(
            f"policy {path}: {type(error).__name__}: {error}"
        ) from error
    return found


class GaitAlone(Policy):
    """Tendon angles of the gait: open loop."""

    STATE = StateParts()

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """The angles and normal forces of the preview."""
        return gait_plan(preview)


def gait_plan(preview: GaitPreview, change: Array | float = 0.0) -> TendonPlan:
    """The angles of a preview, changed by `change` (n, 4), rad, and its normal forces."""
    angle, force = (
        preview.tendon_angle + change,
        np.zeros((*preview.normal_force.shape, 3)),
    )
    force[..., 2] = preview.normal_force
    return TendonPlan(angle, first_rate(angle, preview.dt), force)


PLANNED = (Status.SOLVED, Status.LATE)  # a first plan may be late


class TunedPolicy:
    """Runs a policy; with other settings it is made anew and learns the disturbances again."""

    STATE = StateParts("_policy")

    def __init__(self, make: Callable[[Any], Policy], settings: Any):
        """make: makes the policy with its settings; raises ConfigError as it does."""
        self._make, self._settings = make, settings
        self.changes: dict[str, Any] = {}  # of the settings, by dotted name
        self._policy = make(settings)
        self._last: tuple[Estimate, GaitPreview] | None = None

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """The policy's plan."""
        self._last = estimate, preview
        return self._policy.step(estimate, preview)

    def prepare(self) -> None:
        """Let the policy compute ahead."""
        self._policy.prepare()

    def use_effort(self, effort: Effort) -> None:
        """Let the policy compute so much from its next `prepare` on."""
        self._policy.effort = effort

    def reset(self) -> None:
        """Let the policy begin anew."""
        self._policy.reset()

    def change(self, changes: Mapping[str, Any]) -> None:
        """Change settings, by dotted name.

        Raises ConfigError for an invalid value, while the robot does not stand, and if no plan can
        be made with the new settings.
        """
        wanted = self.changes | dict(changes)
        tried = self._made(wanted)
        if self._last is not None:
            estimate, preview = self._last
            for gait in (preview.gait, preview.command.gait):
                if gait != STAND:
                    raise ConfigError(
                        f"gait {gait}: settings change in {STAND} only, see /set_gait"
                    )
            plan = tried.step(estimate, preview)
            if plan.status not in PLANNED:
                raise ConfigError(f"{', '.join(changes)}: {plan.message}")
        self.use(wanted)

    def use(self, changes: Mapping[str, Any]) -> None:
        """Make the policy with these changes of the first settings; raises ConfigError."""
        self._policy, self.changes = self._made(changes), dict(changes)

    def _made(self, changes: Mapping[str, Any]) -> Policy:
        return self._make(
            config.replace(self._settings, changes, "settings of the policy")
        )


STATES, FEET = 12, len(LEGS)
EXCEED = " ms exceed "
GRAVITY_RANGE = (-20.0, 20.0)  # m/s^2, of an element
STAGE_TIME = (0.001, 0.1)  # s, shortest and longest time between stages


def state_fault(state: Array, most: float) -> str:
    """The fault of a state (12,), whose elements are at most `most`; empty if there is none."""
    return fault_of("state", state, (STATES,), -most, most)


def preview_fault(preview: GaitPreview, stages: int, most: float) -> str:
    """The fault of a preview, which has at least so many stages; empty if there is none."""
    return (
        fault_of("preview.dt", preview.dt, (), *STAGE_TIME)
        or fault_of("preview.contact", preview.contact, (stages, FEET), 0, 1)
        or fault_of(
            "preview.friction", preview.friction, (stages, FEET), 0, most
        )
        or fault_of(
            "preview.normal_force",
            preview.normal_force,
            (stages, FEET),
            -most,
            most,
        )
        or fault_of(
            "preview.tendon_angle",
            preview.tendon_angle,
            (stages, FEET),
            -most,
            most,
        )
        or fault_of(
            "preview.reference",
            preview.reference,
            (stages, STATES),
            -most,
            most,
        )
    )


def time_fault(elapsed: float, budget: float) -> str:
    """The fault of a plan that took `elapsed`, s, of a budget; empty if it was in time."""
    late = f"{elapsed * 1e3:.1f}{EXCEED}{budget * 1e3:g} ms"
    return late if elapsed > budget else ""


def is_late(plan: TendonPlan) -> bool:
    """Whether a plan, also a stopped one, names its computing time as the fault."""
    return EXCEED in plan.message


def fault_of(
    name: str, value: Any, shape: tuple[int, ...], low: float, high: float
) -> str:
    """The fault of an input of `shape`, or ""; two-dimensional inputs may have more rows."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return f"{name}: not numbers"
    usable = (
        array[: shape[0]].shape
        if array.ndim == len(shape) == 2
        else array.shape
    )
    if usable != shape:
        return f"{name}: shape {array.shape}, needs {shape}"
    # false for NaN
    if low <= array.min(initial=high) and array.max(initial=low) <= high:
        return ""
    index = tuple(np.argwhere(~((array >= low) & (array <= high)))[0].tolist())
    where = f"[{', '.join(map(str, index))}]" if index else ""
    return f"{name}{where} = {array[index]:g}: outside [{low:g}, {high:g}]"
