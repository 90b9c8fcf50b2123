"""Settings of the supervisor (`config/supervisor.yaml`), and the limits it sends to the servos."""

from dataclasses import dataclass

import numpy as np

from slot_core import config
from slot_core.config import ConfigError, flag, quantity, text
from slot_core.control.force_map import read_springs
from slot_core.gait.gait import STAND, read_gaits
from slot_core.refusal import quoted
from slot_core.robot import LEGS, read_robot

# a missing gait_scheduler shows as missing forces
NODES = ("state_estimator", "mpc_controller", "force_mapper")


@dataclass(frozen=True)
class Timing:
    """Time limits of inputs and transitions."""

    command_hold: float = quantity(
        "time without a command that ends in HOLD", "s", 0.01, 1
    )
    command_lost: float = quantity(
        "time without a command that ends in RELAX", "s", 0.05, 5
    )
    hold_max: float = quantity("longest HOLD, then RELAX", "s", 0.1, 60)
    holds_max: int = quantity(
        "HOLDs within `holds_window`; one more, then RELAX", "", 1, 1000
    )
    holds_window: float = quantity("time in which HOLDs count", "s", 1, 600)
    recovery: float = quantity(
        "time without a reason to hold that ends HOLD", "s", 0.0, 5
    )
    clock_jump: float = quantity(
        "change of the clock that is a jump", "s", 0.05, 60
    )
    heartbeat: float = quantity(
        "time without a message of a node", "s", 0.05, 10
    )
    estop: float = quantity(
        "time without a message of the e-stop's source", "s", 0.3, 2
    )
    servo_silent: float = quantity(
        "time without an answer of a servo", "s", 0.05, 2
    )
    torque_change: float = quantity(
        "time for the driver to switch torque on or off", "s", 0.05, 5
    )


@dataclass(frozen=True)
class EstimateLimits:
    """Limits of the state estimate."""

    coast_cycles: int = quantity(
        "unusable estimates in a row that are accepted", "", 0, 30
    )
    silence: float = quantity("time without an estimate", "s", 0.01, 5)
    imu_silence: float = quantity(
        "time without a usable IMU that is warned of", "s", 0.05, 5
    )
    tilt_max: float = quantity(
        "largest magnitude of roll and of pitch", "rad", 0.05, 1.5
    )
    place_error: float = quantity(
        "standard deviation beyond which the place is not known", "m", 0.01, 10
    )
    tilt_error: float = quantity(
        "standard deviation beyond which roll and pitch are not known",
        "rad",
        0.01,
        1,
    )


@dataclass(frozen=True)
class GateSettings:
    """Rate limits of the servos' goals, and the ramp to slack."""

    rate_max: float = quantity(
        "rate once a command has been reached", "rad/s", 1, 200
    )
    burst: float = quantity(
        "unused time that a step may use at once", "s", 1e-3, 0.2
    )
    approach_rate: float = quantity(
        "rate until a command is reached", "rad/s", 0.1, 6
    )
    resume_time: float = quantity(
        "time from approach_rate to rate_max", "s", 0.01, 10
    )
    relax_rate: float = quantity("rate of the ramp to slack", "rad/s", 0.1, 20)
    relax_time: float = quantity(
        "longest ramp to slack, then torque goes off", "s", 0.1, 10
    )

    def check_ramp(self, angle_max: float) -> None:
        """Raise ConfigError when a ramp from `angle_max` (rad) takes longer than `relax_time`."""
        ramp = angle_max / self.relax_rate
        if self.relax_time < ramp:
            raise ConfigError(
                f"supervisor.yaml: gate.relax_time = {self.relax_time}: the ramp of"
                f" {angle_max:.3f} rad at relax_rate takes {ramp:.3f} s"
            )


@dataclass(frozen=True)
class ServoLimits:
    """Limits of the servos' watchdog; the supervisor sends them on `/servo_limits`."""

    gate: GateSettings
    command_hold: float = quantity(
        "time without a command that ends in HOLD", "s", 0.01, 1
    )
    command_lost: float = quantity(
        "time without a command that ends in RELAX", "s", 0.05, 5
    )
    clock_jump: float = quantity("distance of a stamp from now", "s", 0.05, 60)
    servo_silent: float = quantity(
        "time without an answer of a servo", "s", 0.05, 2
    )
    standing_angle: float = quantity(
        "tendon angle of all legs to which HOLD moves a robot that walked",
        "rad",
        0,
        3,
    )
    settling: float = quantity(
        "time in a posture after which HOLD keeps the angles", "s", 0, 10
    )


@dataclass(frozen=True)
class TendonLimits:
    """Limits beyond which a tendon counts as slack or broken."""

    slack_max: float = quantity(
        "extra length, inferred from the load", "m", 1e-4, 0.05
    )
    window_min: float = quantity(
        "shortest time of the mean; else a stride", "s", 0.1, 10
    )
    excess_max: float = quantity(
        "slack beyond its limit, summed over time", "m s", 0, 0.1
    )
    sample_gap: float = quantity(
        "gap between two readings that restarts the mean", "s", 1e-3, 1
    )
    age_max: float = quantity(
        "age of a reading, estimate or command that restarts it", "s", 0.01, 1
    )
    stiffness_min: float = quantity(
        "least d torque / d angle to divide by", "N m/rad", 1e-3, 10
    )
    shared: tuple[float, float] = quantity(
        "stiffness of all four legs over the table's that counts for none",
        "",
        0.1,
        10.0,
    )
    share: float = quantity(
        "share of the largest slack for another leg to be named", "", 0, 1
    )
    broken: tuple[bool, bool, bool, bool] = flag(
        "whether a tendon FL FR RL RR is known to be broken and not watched"
    )


@dataclass(frozen=True)
class MotionLimits:
    """Limits below which the walking robot counts as stuck."""

    window: float = quantity(
        "time in which torso and commands are compared", "s", 0.5, 60
    )
    command_min: float = quantity(
        "least extent of a commanded angle", "rad", 0.05, 3
    )
    ratio_min: float = quantity(
        "least extent of the torso's pose over it", "m/rad", 0, 1
    )
    lever: float = quantity(
        "by which angles of the torso count in it", "m", 0, 1
    )
    slip_window: float = quantity(
        "time in which velocity and command are compared", "s", 0.5, 60
    )
    slip_max: float = quantity(
        "velocity off the commanded one that is warned of", "m/s", 1e-3, 1
    )
    slip_hold: float = quantity(
        "velocity off the commanded one that ends in HOLD", "m/s", 1e-3, 1
    )
    progress_min: float = quantity(
        "share of a speed above slip_max below which it is slow", "", 0, 1
    )
    slow_time: float = quantity(
        "time of a slow walk that is not warned of", "s", 0, 60
    )


@dataclass(frozen=True)
class SupervisorSettings:
    """All settings of the supervisor."""

    timing: Timing
    estimate: EstimateLimits
    gate: GateSettings
    tendon: TendonLimits
    motion: MotionLimits
    zero_tolerance: float = quantity(
        "measured tendon angle beyond the range", "rad", 0, 0.5
    )
    arrived: float = quantity(
        "distance to the command that counts as reached", "rad", 1e-3, 1
    )
    nodes: tuple[str, ...] = text("nodes whose heartbeat is needed")
    companions: tuple[str, ...] = text(
        "nodes whose end is said; the robot goes on without them"
    )
    estop_required: bool = flag("whether motion needs a source of the e-stop")
    bench: bool = flag(
        "whether the robot hangs on a bench: its tilt is not watched"
    )

    def __post_init__(self) -> None:
        """Raise ConfigError for a node whose heartbeat the supervisor does not receive."""
        unknown = [node for node in self.nodes if node not in NODES]
        if unknown:
            raise ConfigError(
                f"nodes: {quoted(unknown[0])}: expected some of {', '.join(NODES)}"
            )

    @property
    def servo_limits(self) -> ServoLimits:
        """Limits that the servos' watchdog keeps.

        standing_angle: at which legs at rest carry an equal share of the weight at the height of
        the posture `stand`. settling: duration of a blend of gaits. Raises ConfigError without
        `config/leg_map.csv`.
        """
        timing, robot, gaits = self.timing, read_robot(), read_gaits()
        height = robot.clamp_heights(gaits.postures[STAND].height, 0.0, 0.0)
        share = np.full(len(LEGS), robot.weight / len(LEGS))
        return ServoLimits(
            command_hold=timing.command_hold,
            command_lost=timing.command_lost,
            clock_jump=timing.clock_jump,
            servo_silent=timing.servo_silent,
            gate=self.gate,
            standing_angle=float(read_springs().angle(share, height).mean()),
            settling=gaits.transition,
        )


def read_supervisor() -> SupervisorSettings:
    """The settings of `config/supervisor.yaml`; raises ConfigError."""
    return config.read(SupervisorSettings, "supervisor")
