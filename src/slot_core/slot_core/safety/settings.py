"""What `config/supervisor.yaml` holds."""

from __future__ import annotations

from dataclasses import dataclass

from slot_core import config
from slot_core.config import flag, quantity, text


@dataclass(frozen=True)
class Timing:
    """How long each silence is borne."""

    command_hold: float = quantity("silence of commands that ends in HOLD", "s", 0.01, 1)
    command_lost: float = quantity("silence of commands that ends in RELAX", "s", 0.05, 5)
    hold_max: float = quantity("longest HOLD, then RELAX", "s", 0.1, 60)
    recovery: float = quantity("time without a cause that ends HOLD", "s", 0.0, 5)
    clock_jump: float = quantity("change of the clock that is no passing of time", "s", 0.05, 60)
    heartbeat: float = quantity("silence of a node", "s", 0.05, 10)
    estop: float = quantity("silence of the e-stop's source", "s", 0.05, 2)
    servo_silent: float = quantity("silence of one servo", "s", 0.05, 2)
    obey: float = quantity("within which the driver does what it is told", "s", 0.05, 5)


@dataclass(frozen=True)
class EstimateLimits:
    """When the state estimate carries a gait no more."""

    coast_cycles: int = quantity("unusable estimates in a row that are borne", "", 0, 30)
    period: float = quantity("time between two estimates", "s", 1e-3, 1)
    tilt_max: float = quantity("largest magnitude of roll and of pitch", "rad", 0.05, 1.5)


@dataclass(frozen=True)
class SolverLimits:
    """When the MPC has failed for too long."""

    fallback_cycles: int = quantity("cycles in a row without a solution", "", 0, 1000)


@dataclass(frozen=True)
class ServoLimits:
    """What a servo may report."""

    angle_tolerance: float = quantity("measured angle beyond the range", "rad", 0, 0.5)


@dataclass(frozen=True)
class GateSettings:
    """How fast the goals of the servos may move."""

    rate_max: float = quantity("rate while walking", "rad/s", 1, 200)
    burst: float = quantity("unused time that a step may use at once", "s", 1e-3, 0.2)
    approach_rate: float = quantity(
        "rate while standing and at first after a HOLD", "rad/s", 0.1, 6
    )
    resume_time: float = quantity("from approach_rate to rate_max while walking", "s", 0.01, 10)
    relax_rate: float = quantity("rate of the ramp to slack", "rad/s", 0.1, 20)
    relax_time: float = quantity("torque goes off at the latest", "s", 0.1, 10)
    arrived: float = quantity("distance to the command that counts as reached", "rad", 1e-3, 1)


@dataclass(frozen=True)
class TendonLimits:
    """When a tendon is called slack or broken."""

    slack_max: float = quantity("slack inferred from the load, beside the usual", "m", 1e-4, 0.05)
    window_min: float = quantity("shortest time of the mean; else a stride", "s", 0.1, 10)
    confirm: float = quantity("how long the slack has to last", "s", 0, 5)
    sample_gap: float = quantity("gap between two readings that starts afresh", "s", 1e-3, 1)
    stiffness_min: float = quantity("least d torque / d angle to divide by", "N m/rad", 1e-3, 10)
    share: float = quantity("of the largest slack, for another leg to be named", "", 0, 1)


@dataclass(frozen=True)
class SupervisorSettings:
    """All of it."""

    timing: Timing
    estimate: EstimateLimits
    solver: SolverLimits
    servo: ServoLimits
    gate: GateSettings
    tendon: TendonLimits
    nodes: tuple[str, ...] = text("nodes whose heartbeat is needed")
    estop_required: bool = flag("without a living e-stop source nothing moves")


def read_supervisor() -> SupervisorSettings:
    """The settings of `config/supervisor.yaml`; raises ConfigError."""
    return config.read(SupervisorSettings, "supervisor")
