"""Scene: floor, solver, sensors, start, loads and faults, from `config/scene/<name>.yaml`."""

import math
from dataclasses import dataclass
from typing import Any

from slot_core import config
from slot_core.config import ConfigError, choice, flag, quantity, text
from slot_core.faults import Fault
from slot_core.refusal import quoted
from slot_core.robot import read_parameters


@dataclass(frozen=True)
class FloorSettings:
    """Shape of the floor and contact law; the equations are in `contact.py`."""

    stiffness: float = quantity(
        "contact stiffness of a leg's tip and of the torso's corners",
        "N/m",
        1e2,
        1e7,
    )
    line_stiffness: float = quantity(
        "contact stiffness along a leg", "N/m^2", 0.0, 1e10
    )
    damping: float = quantity(
        "contact damping of a tip or corner; along a leg in proportion to the stiffness",
        "N s/m",
        0.0,
        1e4,
    )
    contact: str = choice("part of a leg that touches the floor", "all", "tip")
    friction: tuple[float, float, float, float] = quantity(
        "friction coefficient of the legs FL FR RL RR", "", 0.0, 5.0
    )
    friction_varies: str = choice(
        "dependence of friction: none, slip inward or outward, tendon pulled or released",
        "uniform",
        "direction",
        "phase",
    )
    friction_other: tuple[float, float, float, float] = quantity(
        "friction coefficient of the legs outward or released, where it varies",
        "",
        0.0,
        5.0,
    )
    torso_friction: float = quantity(
        "friction coefficient of the torso's corners", "", 0.0, 5.0
    )
    friction_law: str = choice(
        "friction law: creeping or sticking", "viscous", "bristle"
    )
    friction_velocity: float = quantity(
        "viscous friction: slip speed at which it is 71 % of Coulomb's",
        "m/s",
        1e-6,
        1.0,
    )
    bristle: float = quantity(
        "bristle friction: tangential over normal stiffness", "", 0.01, 100.0
    )
    height_map: str = text("CSV of heights, m, in config/scene; empty: a plane")
    spacing: float = quantity("spacing of the heights", "m", 1e-3, 10.0)


@dataclass(frozen=True)
class PayloadSettings:
    """A point mass on the torso."""

    mass: float = quantity("mass of the payload", "kg", 0.0, 20.0)
    place: tuple[float, float, float] = quantity(
        "position of the payload in base_link", "m", -1.0, 1.0
    )


@dataclass(frozen=True)
class TendonDamage:
    """Damage of the tendons FL FR RL RR from the start of the run."""

    slack: tuple[float, float, float, float] = quantity(
        "slack beside the usual one; negative: shorter tendon", "m", -0.01, 0.1
    )
    broken: tuple[bool, bool, bool, bool] = flag(
        "whether a tendon is broken and carries no tension"
    )


@dataclass(frozen=True)
class Push:
    """An external force and moment on the torso's centre for a limited time."""

    time: float = quantity("start time", "s", 0.0, 1e6)
    duration: float = quantity("duration", "s", 0.0, 1e6)
    force: tuple[float, float, float] = quantity(
        "force in odom", "N", -1e4, 1e4
    )
    moment: tuple[float, float, float] = quantity(
        "moment in odom", "N m", -1e3, 1e3
    )


@dataclass(frozen=True)
class SolverSettings:
    """Model of the legs and discretisation; the scheme is in `integrator.py`.

    Nodes and steps of `paper` legs are in config/paper.yaml; `map` legs have neither.
    """

    legs: str = choice(
        "model of the legs: rods, quasi-static, or as published",
        "spatial",
        "map",
        "paper",
    )
    nodes: int = quantity("nodes per leg", "", 4, 401)
    step: float = quantity("time step", "s", 1e-6, 0.02)
    theta: float = quantity("stage of the theta scheme", "", 0.5, 1.0)
    iterations: int = quantity("Newton iterations per step", "", 1, 20)
    halvings: int = quantity("largest number of halvings of a step", "", 0, 12)
    correction_limit: float = quantity(
        "energy that the last Newton correction may leave in a contact",
        "J",
        1e-15,
        1e6,
    )
    speed_limit: float = quantity(
        "speed of a node beyond which the solution counts as diverged",
        "m/s",
        1.0,
        1e6,
    )


@dataclass(frozen=True)
class Dropout:
    """A time without odometry, in which a visual SLAM publishes that it is lost."""

    time: float = quantity("start time", "s", 0.0, 1e6)
    duration: float = quantity("duration", "s", 0.0, 1e6)


@dataclass(frozen=True)
class Jump:
    """A lasting displacement of the odometry, as a relocalisation makes one."""

    time: float = quantity("time", "s", 0.0, 1e6)
    position: tuple[float, float, float] = quantity(
        "displacement of the odometry in odom", "m", -100.0, 100.0
    )
    yaw: float = quantity(
        "turn of the odometry about the origin of odom", "rad", -3.15, 3.15
    )


@dataclass(frozen=True)
class OdometrySettings:
    """Pose and twist as published by a visual SLAM, with its drift, losses and jumps."""

    period: float = quantity("period of the readings", "s", 1e-3, 10.0)
    delay: float = quantity("delay from capture to publication", "s", 0.0, 1.0)
    position_noise: float = quantity(
        "standard deviation of the position per axis", "m", 0.0, 1.0
    )
    orientation_noise: float = quantity(
        "standard deviation of the orientation per axis", "rad", 0.0, 1.0
    )
    velocity_noise: float = quantity(
        "standard deviation of the velocity per axis", "m/s", 0.0, 10.0
    )
    rate_noise: float = quantity(
        "standard deviation of the angular velocity per axis",
        "rad/s",
        0.0,
        10.0,
    )
    jitter: float = quantity("largest deviation of the delay", "s", 0.0, 1.0)
    position_drift: float = quantity(
        "random walk of the position per axis", "m/sqrt(s)", 0.0, 1.0
    )
    yaw_drift: float = quantity(
        "random walk of the yaw", "rad/sqrt(s)", 0.0, 1.0
    )
    loss: float = quantity("share of lost readings", "", 0.0, 1.0)
    dropouts: dict[str, Dropout] = text("times without odometry by name")
    jumps: dict[str, Jump] = text("jumps of the odometry by name")


@dataclass(frozen=True)
class CameraSettings:
    """A camera whose images `marker_localizer` turns into the odometry; see vision.yaml."""

    enabled: bool = flag("whether images take the place of the odometry")
    carrier: str = choice(
        "what the camera stands on; boards are on the other", "torso", "world"
    )
    boards: tuple[str, ...] = text("boards of vision.yaml that are there")
    period: float = quantity("period of the images", "s", 1e-3, 10.0)
    delay: float = quantity(
        "delay from mid exposure to publication", "s", 0.0, 1.0
    )
    noise: float = quantity(
        "standard deviation of a pixel", "grey levels", 0.0, 100.0
    )
    blur: float = quantity(
        "standard deviation of the lens' blur", "px", 0.0, 20.0
    )
    exposure: float = quantity("exposure time", "s", 0.0, 0.1)


@dataclass(frozen=True)
class ImuSettings:
    """Gyroscope and accelerometer at the torso's centre."""

    enabled: bool = flag("whether the robot has an IMU")
    period: float = quantity("period of the readings", "s", 1e-4, 1.0)
    rate_noise: float = quantity(
        "standard deviation of the gyroscope", "rad/s", 0.0, 10.0
    )
    rate_bias: float = quantity(
        "standard deviation of the gyroscope's bias", "rad/s", 0.0, 1.0
    )
    acceleration_noise: float = quantity(
        "standard deviation of the accelerometer", "m/s^2", 0.0, 100.0
    )


@dataclass(frozen=True)
class SensorSettings:
    """Odometry or camera, IMU, tendon encoders and ground truth."""

    odometry: OdometrySettings
    camera: CameraSettings
    imu: ImuSettings
    joints: bool = flag("whether tendon angles are measured")
    joint_period: float = quantity(
        "period of the tendon angles", "s", 1e-3, 1.0
    )
    truth: bool = flag("whether exact motion, forces and shapes are published")


NO_SENSORS = {
    "sensors.imu.period": 1.0,
    "sensors.joint_period": 1.0,
    "sensors.odometry.period": 1.0,
}
"""Changes of a scene whose sensors are not read: so seldom that they cost nothing."""


@dataclass(frozen=True)
class StartSettings:
    """Start of a run: natural legs and slack tendons, then settling until time zero."""

    height: float = quantity(
        "height of the torso's centre above the floor", "m", 0.0, 10.0
    )
    tendon_angle_deg: float = quantity(
        "commanded tendon angle while settling", "deg", 0.0, 360.0
    )
    settle: float = quantity(
        "duration of settling before time zero", "s", 0.0, 60.0
    )


@dataclass(frozen=True)
class Scene:
    """All settings of a run except the robot and its servos."""

    floor: FloorSettings
    solver: SolverSettings
    sensors: SensorSettings
    start: StartSettings
    payload: PayloadSettings
    tendons: TendonDamage
    pushes: dict[str, Push] = text("pushes by name")
    faults: dict[str, Fault] = text("faults by name")
    gravity: tuple[float, float, float] = quantity(
        "gravity in odom, z normal to the floor", "m/s^2", -50, 50
    )
    supply_voltage: float = quantity(
        "supply voltage of the servos; within the maker's figures in servo.yaml",
        "V",
        9.0,
        12.0,
    )
    parameters: str = text(
        "set of config/parameters of the robot in it; empty: robot.yaml's"
    )

    def __post_init__(self) -> None:
        """Raise ConfigError if a sensor's period is shorter than the time step: it never ends."""
        sensors, step = self.sensors, self.solver.step
        periods = {
            "sensors.odometry.period": sensors.odometry.period,
            "sensors.camera.period": sensors.camera.period
            if sensors.camera.enabled
            else math.inf,
            "sensors.imu.period": sensors.imu.period
            if sensors.imu.enabled
            else math.inf,
            "sensors.joint_period": sensors.joint_period
            if sensors.joints
            else math.inf,
        }
        for name, period in periods.items():
            if period < step:
                raise ConfigError(
                    f"{name} = {period}: shorter than solver.step = {step} s"
                )


def read_scene(name: str) -> Scene:
    """The scene of `config/scene/<name>.yaml`.

    A file with `like: OTHER` holds, by dotted name, only its changes of the other scene.
    `solver: NAME` stands for the settings of `config/solver/NAME.yaml`. `parameters: NAME` stands
    for the `scene` values of that set of `config/parameters`, unless the file has its own. Raises
    ConfigError; for an unknown name it lists near or known ones.
    """
    mapping, where = _load(name), f"scene/{name}.yaml"
    if not _is_like_another(mapping):
        return config.build(Scene, mapping, where)
    other = mapping.pop("like")
    whole = _load(other) if isinstance(other, str) else {"like": other}
    if _is_like_another(whole):
        raise ConfigError(
            f"{where}: like = {quoted(other)}: expected the name of a scene without `like`"
        )
    base = config.build(Scene, whole, f"scene/{other}.yaml")
    identified = mapping.get("parameters")
    if isinstance(identified, str) and identified:
        mapping = read_parameters(identified, "scene") | mapping
    return config.replace(base, mapping, where)


def _is_like_another(mapping: Any) -> bool:
    return isinstance(mapping, dict) and "like" in mapping


def _load(name: str) -> Any:
    """Content of a scene's file, with the settings of the solver that it names."""
    mapping = config.load(f"scene/{name}")
    if isinstance(mapping, dict) and isinstance(mapping.get("solver"), str):
        mapping["solver"] = config.load(f"solver/{mapping['solver']}")
    return mapping


def level_changes(level: str) -> dict[str, Any]:
    """Changes of a scene, by dotted name, that simulate it at a level of `config/solver`."""
    return {
        f"solver.{name}": value
        for name, value in config.load(f"solver/{level}").items()
    }
