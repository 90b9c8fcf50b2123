"""Settings of the rollout MPC: `config/rollout_mpc.yaml`."""

from dataclasses import dataclass
from itertools import pairwise

from slot_core import config
from slot_core.config import flag, quantity
from slot_core.gait.gait import Vector3


@dataclass(frozen=True)
class NominalSettings:
    """The robot that the policy simulates."""

    friction: float = quantity("friction coefficient of the floor", "", 0.01, 2)
    posture_friction: float = quantity(
        "largest friction coefficient of a level floor in a posture",
        "",
        0.01,
        2,
    )
    broken: tuple[bool, bool, bool, bool] = flag(
        "whether a tendon FL FR RL RR carries nothing"
    )
    springs: Vector3 = quantity(
        "stiffness of the feet along, aside and in turn over that of the leg table",
        "",
        1,
        1e4,
    )
    width: float = quantity(
        "width of the feet over that of the legs", "", 0.01, 2
    )
    slope: bool = flag("whether gravity follows the tilt of the floor")
    cycles: int = quantity("cycles of the servo bus in a stage", "", 1, 20)
    steps: int = quantity(
        "steps of the integration in a cycle of the servo bus", "", 1, 100
    )
    iterations: int = quantity("Newton iterations of a step", "", 1, 10)


@dataclass(frozen=True)
class CostSettings:
    """Deviations that cost as much as one another; a smaller one weighs more."""

    tilt: float = quantity("error of roll and pitch", "rad", 1e-4, 10)
    yaw: float = quantity("error of the yaw", "rad", 1e-4, 10)
    place: float = quantity("error of x and y", "m", 1e-5, 10)
    height: float = quantity("error of the height", "m", 1e-5, 10)
    deviation: float = quantity(
        "mean deviation of a tendon angle from the gait's", "rad", 1e-3, 100
    )
    swing: float = quantity(
        "difference of a deviation from its mean", "rad", 1e-3, 100
    )
    change: float = quantity(
        "change of a planned tendon angle in one tick", "rad", 1e-4, 100
    )
    reach: float = quantity(
        "largest distance of a reference from the robot", "m", 1e-3, 1
    )


@dataclass(frozen=True)
class ObserverSettings:
    """Observer of the disturbances that the nominal robot lacks; gains are per tick."""

    window: int = quantity(
        "ticks over which measured and simulated motion differ", "", 2, 200
    )
    drift_gain: float = quantity(
        "gain of the drift, the error of the velocity", "", 0, 1
    )
    drift_max: Vector3 = quantity(
        "largest drift of x, y and yaw", "m/s, m/s, rad/s", 0, 1
    )
    drift_taken: Vector3 = quantity(
        "largest drift of x, y and yaw that the plan takes",
        "m/s, m/s, rad/s",
        0,
        1,
    )
    wrench_gain: float = quantity("gain of the wrench on the torso", "", 0, 1)
    stiffness: Vector3 = quantity(
        "wrench per error of height, roll and pitch",
        "N/m, N m/rad, N m/rad",
        0,
        1e4,
    )
    wrench_max: Vector3 = quantity(
        "largest wrench: F_z, M_x, M_y", "N, N m, N m", 0, 100
    )
    friction_gain: float = quantity(
        "gain of mean and variance of the errors with each friction", "", 0, 1
    )
    friction_margin: float = quantity(
        "share by which a floor that grips explains less before it is given up",
        "",
        0,
        1e3,
    )
    friction_misfit: float = quantity(
        "spread of the errors with the nominal friction above which a floor grips",
        "",
        0,
        1e3,
    )
    friction_benefit: float = quantity(
        "variance that a floor that grips explains, above which it does",
        "",
        0,
        1e3,
    )
    benefit_gain: float = quantity(
        "gain of the mean of that variance", "", 0, 1
    )
    friction_after: float = quantity(
        "time of a walk after which the friction is judged", "s", 0, 100
    )
    friction: float = quantity(
        "friction coefficient of a floor that grips", "", 0.01, 2
    )


@dataclass(frozen=True)
class PostureSettings:
    """Feedback of a posture that is kept; the gains are per tick."""

    reach: Vector3 = quantity(
        "errors of height, roll and pitch below which it acts",
        "m, rad, rad",
        0,
        10,
    )
    rise_max: float = quantity(
        "largest speed of the height at which it begins", "m/s", 0, 10
    )
    filter: float = quantity("gain of the filtered error", "", 0, 1)
    gain: float = quantity("gain of the sum of the errors", "", 0, 1)
    stiffness: Vector3 = quantity(
        "wrench per error of height, roll and pitch",
        "N/m, N m/rad, N m/rad",
        0,
        1e4,
    )


@dataclass(frozen=True)
class LimitSettings:
    """Limits of the plan, and of how long one is used without a new one."""

    deviation: float = quantity(
        "largest deviation of a tendon angle from the gait's", "rad", 0, 3
    )
    angle_min: float = quantity(
        "least tendon angle, or the gait's where that is less", "rad", 0, 3
    )
    rate: float = quantity(
        "largest rate of a tendon angle, or the gait's", "rad/s", 0.1, 100
    )
    time_budget: float = quantity("longest time for a plan", "s", 0, 1)
    input_max: float = quantity(
        "largest accepted magnitude of any input, SI units", "", 1, 1e9
    )
    cycles: int = quantity(
        "largest number of cycles in a row without a new plan", "", 0, 1000
    )
    decay: float = quantity(
        "factor per cycle of deviations that no plan renews", "", 0, 1
    )


@dataclass(frozen=True)
class RolloutMpcSettings:
    """Settings of `config/rollout_mpc.yaml`."""

    nominal: NominalSettings
    cost: CostSettings
    observer: ObserverSettings
    posture: PostureSettings
    limits: LimitSettings
    stages: int = quantity("stages of the horizon", "", 2, 99)
    knots: tuple[int, ...] = quantity(
        "stages between which the change of a tendon angle is linear", "", 0, 99
    )
    step: float = quantity(
        "change of a tendon angle for finite differences", "rad", 1e-4, 1
    )

    def __post_init__(self) -> None:
        """Raise ConfigError for knots that are no grid of the horizon."""
        knots = self.knots
        rising = all(a < b for a, b in pairwise(knots))
        if (
            len(knots) < 2
            or knots[0] != 0
            or not rising
            or knots[-1] > self.stages
        ):
            raise config.ConfigError(
                f"knots = {knots}: expected 0, then rising to at most stages = {self.stages}"
            )


def read_rollout_mpc() -> RolloutMpcSettings:
    """The settings of `config/rollout_mpc.yaml`; raises ConfigError."""
    return config.read(RolloutMpcSettings, "rollout_mpc")
