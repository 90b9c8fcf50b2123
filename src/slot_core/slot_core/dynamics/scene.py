"""A scene: the floor, the solver, the sensors and the start, from `config/scene/<name>.yaml`."""

from __future__ import annotations

from dataclasses import dataclass

from slot_core import config
from slot_core.config import quantity


@dataclass(frozen=True)
class FloorSettings:
    """Contact law; `contact.py` says what the numbers do."""

    stiffness: float = quantity("contact stiffness of each node", "N/m", 1e2, 1e7)
    damping: float = quantity("contact damping of each node", "N s/m", 0.0, 1e4)
    friction: tuple[float, float, float, float] = quantity("of the legs FL FR RL RR", "", 0.0, 5.0)
    torso_friction: float = quantity("of the torso's corners", "", 0.0, 5.0)
    friction_velocity: float = quantity("slip at which friction is 71 %", "m/s", 1e-6, 1.0)


@dataclass(frozen=True)
class SolverSettings:
    """Discretisation in space and time; `integrator.py` says what the numbers do."""

    nodes: int = quantity("nodes of a leg", "", 4, 401)
    step: float = quantity("time step", "s", 1e-6, 0.02)
    theta: float = quantity("stage of the theta scheme", "", 0.5, 1.0)
    iterations: int = quantity("Newton iterations per step", "", 1, 20)
    halvings: int = quantity("how often a step may be halved", "", 0, 12)
    correction_limit: float = quantity("last Newton correction that is accepted", "m/s", 1e-9, 1e6)
    speed_limit: float = quantity("a faster node means a lost solution", "m/s", 1.0, 1e6)


@dataclass(frozen=True)
class OdometrySettings:
    """Pose and twist as a visual SLAM gives them."""

    period: float = quantity("time between readings", "s", 1e-3, 10.0)
    delay: float = quantity("from capture to publication", "s", 0.0, 1.0)
    position_noise: float = quantity("standard deviation, each axis", "m", 0.0, 1.0)
    orientation_noise: float = quantity("standard deviation, each axis", "rad", 0.0, 1.0)
    velocity_noise: float = quantity("standard deviation, each axis", "m/s", 0.0, 10.0)
    rate_noise: float = quantity("standard deviation, each axis", "rad/s", 0.0, 10.0)


@dataclass(frozen=True)
class ImuSettings:
    """Gyroscope and accelerometer at the torso's centre."""

    period: float = quantity("time between readings", "s", 1e-4, 1.0)
    rate_noise: float = quantity("gyroscope, standard deviation", "rad/s", 0.0, 10.0)
    rate_bias: float = quantity("gyroscope, standard deviation of its bias", "rad/s", 0.0, 1.0)
    acceleration_noise: float = quantity("accelerometer, standard deviation", "m/s^2", 0.0, 100.0)


@dataclass(frozen=True)
class SensorSettings:
    """All sensors."""

    odometry: OdometrySettings
    imu: ImuSettings
    joint_period: float = quantity("time between readings of the tendon angles", "s", 1e-3, 1.0)


@dataclass(frozen=True)
class StartSettings:
    """How a run begins: natural legs and slack tendons, then a time for settling, not counted."""

    height: float = quantity("torso's centre above the floor", "m", 0.0, 10.0)
    tendon_angle_deg: float = quantity("command while settling", "deg", 0.0, 360.0)
    settle: float = quantity("time of settling before time zero", "s", 0.0, 60.0)


@dataclass(frozen=True)
class Scene:
    """Everything about a run that is neither the robot nor its servos."""

    floor: FloorSettings
    solver: SolverSettings
    sensors: SensorSettings
    start: StartSettings
    gravity: tuple[float, float, float] = quantity(
        "in odom, z normal to the floor", "m/s^2", -50, 50
    )


def read_scene(name: str) -> Scene:
    """The scene of `config/scene/<name>.yaml`; ConfigError names the known ones.

    A file with `like: OTHER` holds, by dotted name, only what it changes of that other scene.
    """
    mapping, where = config.load(f"scene/{name}"), f"scene/{name}.yaml"
    if not isinstance(mapping, dict) or "like" not in mapping:
        return config.build(Scene, mapping, where)
    base = config.read(Scene, f"scene/{mapping.pop('like')}")
    return config.replace(base, mapping, where)
