"""A scene: the floor, the solver, the sensors and the start, from `config/scene/<name>.yaml`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from slot_core import config
from slot_core.config import choice, flag, quantity, text
from slot_core.faults import Fault


@dataclass(frozen=True)
class FloorSettings:
    """Shape of the floor and contact law; `contact.py` and `terrain.py` say what the numbers do."""

    stiffness: float = quantity("of a leg's tip and of the torso's corners", "N/m", 1e2, 1e7)
    line_stiffness: float = quantity("along a leg", "N/m^2", 0.0, 1e10)
    damping: float = quantity("of a tip or corner; along a leg in proportion", "N s/m", 0.0, 1e4)
    contact: str = choice("what of a leg touches the floor", "all", "tip")
    friction: tuple[float, float, float, float] = quantity("of the legs FL FR RL RR", "", 0.0, 5.0)
    friction_varies: str = choice(
        "with the slip inward or outward, or with the tendon pulled or released",
        "uniform", "direction", "phase",
    )  # fmt: skip
    friction_other: tuple[float, float, float, float] = quantity(
        "of the legs, outward or released, where it varies", "", 0.0, 5.0
    )
    torso_friction: float = quantity("of the torso's corners", "", 0.0, 5.0)
    friction_law: str = choice("creeping or sticking", "viscous", "bristle")
    friction_velocity: float = quantity("viscous: slip at which it is 71 %", "m/s", 1e-6, 1.0)
    bristle: float = quantity("bristle: tangential over normal stiffness", "", 0.01, 100.0)
    height_map: str = text("CSV of heights in config/scene, m; none: a plane")
    spacing: float = quantity("of the heights", "m", 1e-3, 10.0)


@dataclass(frozen=True)
class PayloadSettings:
    """A point mass on the torso."""

    mass: float = quantity("mass", "kg", 0.0, 20.0)
    place: tuple[float, float, float] = quantity("in base_link", "m", -1.0, 1.0)


@dataclass(frozen=True)
class TendonDamage:
    """What is wrong with the tendons, FL FR RL RR."""

    slack: tuple[float, float, float, float] = quantity("beside the usual one", "m", 0.0, 0.1)
    broken: tuple[bool, bool, bool, bool] = flag("carries nothing")


@dataclass(frozen=True)
class Push:
    """An outer force and moment on the torso's centre for a while."""

    time: float = quantity("of its begin", "s", 0.0, 1e6)
    duration: float = quantity("how long", "s", 0.0, 1e6)
    force: tuple[float, float, float] = quantity("in odom", "N", -1e4, 1e4)
    moment: tuple[float, float, float] = quantity("in odom", "N m", -1e3, 1e3)


@dataclass(frozen=True)
class SolverSettings:
    """Model of the legs and discretisation; `integrator.py` says what the numbers do.

    `paper` legs have nodes and steps of their own (config/paper.yaml), `map` legs have neither.
    """

    legs: str = choice("how they move: rods, quasi-static or as published", "rod", "map", "paper")
    nodes: int = quantity("nodes of a leg", "", 4, 401)
    step: float = quantity("time step", "s", 1e-6, 0.02)
    theta: float = quantity("stage of the theta scheme", "", 0.5, 1.0)
    iterations: int = quantity("Newton iterations per step", "", 1, 20)
    halvings: int = quantity("how often a step may be halved", "", 0, 12)
    correction_limit: float = quantity(
        "energy that the last Newton correction may leave in a contact", "J", 1e-15, 1e6
    )
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

    enabled: bool = flag("whether there is one")
    period: float = quantity("time between readings", "s", 1e-4, 1.0)
    rate_noise: float = quantity("gyroscope, standard deviation", "rad/s", 0.0, 10.0)
    rate_bias: float = quantity("gyroscope, standard deviation of its bias", "rad/s", 0.0, 1.0)
    acceleration_noise: float = quantity("accelerometer, standard deviation", "m/s^2", 0.0, 100.0)


@dataclass(frozen=True)
class SensorSettings:
    """All sensors."""

    odometry: OdometrySettings
    imu: ImuSettings
    joints: bool = flag("whether tendon angles are read")
    joint_period: float = quantity("time between readings of the tendon angles", "s", 1e-3, 1.0)
    truth: bool = flag("whether exact motion, forces and shapes are reported")


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
    payload: PayloadSettings
    tendons: TendonDamage
    pushes: dict[str, Push] = text("pushes by name")
    faults: dict[str, Fault] = text("faults by name")
    gravity: tuple[float, float, float] = quantity(
        "in odom, z normal to the floor", "m/s^2", -50, 50
    )


def read_scene(name: str) -> Scene:
    """The scene of `config/scene/<name>.yaml`; ConfigError names the known ones.

    A file with `like: OTHER` holds, by dotted name, only what it changes of that other scene.
    `solver: NAME` stands for the settings of `config/solver/NAME.yaml`.
    """
    mapping, where = _load(name), f"scene/{name}.yaml"
    if not isinstance(mapping, dict) or "like" not in mapping:
        return config.build(Scene, mapping, where)
    other = mapping.pop("like")
    base = config.build(Scene, _load(other), f"scene/{other}.yaml")
    return config.replace(base, mapping, where)


def _load(name: str) -> Any:
    """A scene's file with the settings of the solver that it names."""
    mapping = config.load(f"scene/{name}")
    if isinstance(mapping, dict) and isinstance(mapping.get("solver"), str):
        mapping["solver"] = config.load(f"solver/{mapping['solver']}")
    return mapping
