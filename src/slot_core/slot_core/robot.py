"""The robot: geometry, masses, limits, leg order and frames, from `config/robot.yaml`.

Values fitted to data are in a parameter set of `config/parameters`, which robot.yaml names.

Frames (REP-103, REP-105): `odom` is the world, z up. `base_link` is the torso's centre, x forward,
y left, z up. Leg frame i is fixed to the torso at its corner: origin at the clamp, x outward along
the leg's azimuth, z up; the leg deforms in its x-z plane.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import ConfigError, quantity
from slot_core.elementary import cos, exp, hypot, sin
from slot_core.geometry import upward
from slot_core.matrices import product
from slot_core.names import LEGS as LEGS  # noqa: PLC0414 - for users of the robot
from slot_core.refusal import quoted

TENDON_JOINTS = tuple(f"{leg}_tendon" for leg in LEGS)
ARC_CELLS = 4000  # of a leg's natural shape
GRAVITY = 9.81  # m/s^2, the value of the paper
ODOM_FRAME = "odom"
FLOOR_FRAME = (
    "floor"  # z = 0 where the feet are, see estimation/floor_observer.py
)
BASE_FRAME = "base_link"
# below base_link, on the floor of odom (REP-120)
FOOTPRINT_FRAME = "base_footprint"
# Points of torso and legs that are tracked, and the columns of a CSV file with their places.
TORSO = "torso"
# share of a leg's arc length
LEG_POINTS = {"base": 0.0, "third": 1 / 3, "two_thirds": 2 / 3, "tip": 1.0}
BODY_POINTS = (*(f"{leg}_{name}" for leg in LEGS for name in LEG_POINTS), TORSO)
# of a leg with points along it; the tabulated robot's have two, clamp and foot
LEAST_NODES = 4
POINT_COLUMNS = ("time", "point", "x", "y", "z")  # s, m
POINT_FRAME = "frame: "  # begins the comment of the file that names its frame


@dataclass(frozen=True)
class Torso:
    """The rigid box between the legs."""

    mass: float = quantity("mass of the torso", "kg", 0.02, 20.0)
    size: tuple[float, float, float] = quantity(
        "edge lengths of the torso along x, y, z", "m", 0.01, 1.0
    )

    @property
    def inertia(self) -> Array:
        """(3, 3) kg m^2 about the centre of a homogeneous box: I_x = m (b^2 + c^2) / 12."""
        square = np.square(self.size)
        return np.diag(self.mass / 12 * (square.sum() - square))


@dataclass(frozen=True)
class Leg:
    """One tapered TPU leg, clamped to the torso with a horizontal tangent."""

    azimuth_deg: tuple[float, float, float, float] = quantity(
        "azimuth of FL FR RL RR", "deg", -180, 180
    )
    reach: float = quantity(
        "horizontal extent of a leg's natural shape", "m", 0.02, 1.0
    )
    natural_shape: tuple[float, float, float, float] = quantity(
        "cubic z(x) of the stress-free centre line, highest power first",
        "",
        -100,
        100,
    )
    width: float = quantity("width of a leg", "m", 1e-4, 0.2)
    contact_width: float = quantity(
        "distance of a leg's edges that touch the floor", "m", 1e-4, 0.2
    )
    thickness_clamp: float = quantity(
        "thickness of a leg at the clamp", "m", 1e-4, 0.1
    )
    thickness_tip: float = quantity(
        "thickness of a leg at the tip, linear in between", "m", 1e-4, 0.1
    )
    density: float = quantity("density of the leg's material", "kg/m^3", 1, 2e4)
    young_modulus: float = quantity(
        "Young's modulus of the leg's material", "Pa", 1e5, 1e9
    )
    poisson_ratio: float = quantity(
        "Poisson's ratio of the leg's material", "", 0.0, 0.499
    )
    damping_time: float = quantity(
        "Kelvin-Voigt time constant of the material", "s", 0, 0.1
    )
    relaxation_share: tuple[float, float] = quantity(
        "moduli of two Maxwell branches over Young's modulus", "", 0.0, 10.0
    )
    relaxation_time: tuple[float, float] = quantity(
        "relaxation times of the branches", "s", 1e-3, 100.0
    )

    @cached_property
    def shape(self) -> Polynomial:
        """z(x) of the natural centre line, both in m; the tip is drawn on the floor z = 0."""
        return Polynomial(self.natural_shape[::-1])

    @cached_property
    def arc(self) -> tuple[Array, Array]:
        """Places x (n,) from the clamp to the tip and the arc lengths (n,) there, m.

        By Simpson's rule in each cell; its error is below 1e-15 m.
        """
        x, slope = (
            np.linspace(0.0, self.reach, ARC_CELLS + 1),
            self.shape.deriv(),
        )
        begin, middle, end = (
            hypot(1.0, slope(at))
            for at in (x[:-1], (x[:-1] + x[1:]) / 2, x[1:])
        )
        return x, np.append(
            0.0, np.cumsum(np.diff(x) / 6 * (begin + 4 * middle + end))
        )

    def arc_length(self) -> float:
        """Arc length of the natural shape from the clamp to the tip, m."""
        return float(self.arc[1][-1])

    @property
    def shear_modulus(self) -> float:
        """Pa, G = E / (2 (1 + nu)) of an isotropic material."""
        return self.young_modulus / (2.0 * (1.0 + self.poisson_ratio))

    @property
    def relaxes(self) -> bool:
        """Whether the material has Maxwell branches."""
        return any(self.relaxation_share)

    def thickness(self, fraction: Array) -> Array:
        """Thickness at shares of the leg's arc length, m."""
        return (
            self.thickness_clamp
            + (self.thickness_tip - self.thickness_clamp) * fraction
        )

    @cached_property
    def mass(self) -> float:
        """kg: density times width times mean thickness times arc length."""
        thickness = (self.thickness_clamp + self.thickness_tip) / 2
        return self.density * self.width * thickness * self.arc_length()


@dataclass(frozen=True)
class Tendon:
    """The tendon of a leg: from the spool through the clamp, at an offset below the centre line."""

    end_fraction: float = quantity(
        "arc length of the tendon's anchor as a share of the leg's",
        "",
        0.1,
        1.0,
    )
    offset: float = quantity(
        "distance of the tendon below the leg's centre line", "m", 1e-3, 0.05
    )
    cable_stiffness: float = quantity("stiffness of the cable", "N/m", 1e3, 1e8)
    cable_damping: float = quantity("damping of the cable", "N s/m", 0, 1e3)
    slack: float = quantity("slack of a tendon at angle zero", "m", 0, 0.02)
    spool_radius: float = quantity("radius of the spool", "m", 1e-3, 0.05)
    angle_max_deg: float = quantity("largest tendon angle", "deg", 1, 360)
    guide_friction: float = quantity(
        "friction coefficient of the cable in its guide", "", 0.0, 1.0
    )
    guide_angle_deg: float = quantity(
        "angle by which the guide turns the cable", "deg", 0.0, 720.0
    )

    @property
    def capstan(self) -> float:
        """Tension at the spool over that in the leg while the spool winds: exp(mu alpha), Euler."""
        return exp(self.guide_friction * math.radians(self.guide_angle_deg))

    @property
    def angle_max(self) -> float:
        """Largest tendon angle, rad; the smallest is zero."""
        return math.radians(self.angle_max_deg)


@dataclass(frozen=True)
class RobotParameters:
    """Torso, four equal legs and their tendons; arrays over legs are in the order of `LEGS`."""

    torso: Torso
    leg: Leg
    tendon: Tendon

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return self.torso.mass + 4 * self.leg.mass

    @property
    def weight(self) -> float:
        """Total weight, N."""
        return self.mass * GRAVITY

    @cached_property
    def azimuth(self) -> Array:
        """(4,) azimuth of the leg frames about base_link z, rad."""
        return np.radians(self.leg.azimuth_deg)

    @cached_property
    def clamps(self) -> Array:
        """(4, 3) clamps in base_link, m: at the corner each azimuth points to, at mid height."""
        corner = np.array([self.torso.size[0] / 2, self.torso.size[1] / 2, 0.0])
        return np.sign(self.outward.round(9)) * corner

    def clamp_heights(
        self, height: float | Array, roll: float | Array, pitch: float | Array
    ) -> Array:
        """Clamps above the floor (..., 4) m, at heights (m), rolls and pitches (rad) (...)."""
        x, y, z = (
            np.multiply.outer(part, axis)
            for part, axis in zip(upward(roll, pitch), self.clamps.T)
        )
        return np.asarray(np.asarray(height)[..., None] + x + y + z)

    @cached_property
    def outward(self) -> Array:
        """(4, 3) unit x axes of the leg frames in base_link."""
        return np.column_stack(
            [cos(self.azimuth), sin(self.azimuth), np.zeros(4)]
        )

    @cached_property
    def rightward(self) -> Array:
        """(4, 3) unit vectors in base_link across the legs' width, to the right looking outward."""
        return np.cross(self.outward, [0.0, 0.0, 1.0])

    @cached_property
    def feet(self) -> Array:
        """(4, 3) tips of the natural legs in base_link, m."""
        return (
            self.clamps
            + self.leg.reach * self.outward
            + [0.0, 0.0, self.leg.shape(self.leg.reach) - self.leg.shape(0.0)]
        )

    @cached_property
    def inertia(self) -> Array:
        """(3, 3) kg m^2 about base_link's origin: torso plus the legs in their natural shape."""
        x = (np.arange(200) + 0.5) / 200 * self.leg.reach
        ds = hypot(1.0, self.leg.shape.deriv()(x))
        taper = self.leg.thickness(x / self.leg.reach)
        mass = self.leg.mass * (ds * taper) / (ds * taper).sum()
        drop = self.leg.shape(x) - self.leg.shape(0.0)
        points = (
            self.clamps[:, None]
            + x[:, None] * self.outward[:, None]
            + drop[:, None] * np.array([0.0, 0.0, 1.0])
        )
        flat = points.reshape(-1, 3)
        square = product((np.tile(mass, len(LEGS))[:, None] * flat).T, flat)
        return self.torso.inertia + square.diagonal().sum() * np.eye(3) - square


def read_robot(parameters: str = "") -> RobotParameters:
    """The robot of `config/robot.yaml` with a set of `config/parameters`; raises ConfigError.

    `parameters` names the set; if empty, it is the one named in robot.yaml. A value that is set in
    both files is an error.
    """
    mapping = config.load("robot")
    if not isinstance(mapping, dict) or "parameters" not in mapping:
        raise ConfigError(
            "robot.yaml: parameters is missing: the name of a parameter set"
        )
    if not isinstance(named := mapping.pop("parameters"), str):
        raise ConfigError(
            f"robot.yaml: parameters = {quoted(named)}: expected a name"
        )
    name = parameters or named
    content = config.load(f"parameters/{name}")
    for dotted, value in _part(content, name, "values").items():
        _insert(mapping, dotted, value, f"parameters/{name}.yaml")
    robot = config.build(
        RobotParameters, mapping, f"robot.yaml with parameters/{name}.yaml"
    )
    return config.replace(
        robot, _part(content, name, "robot"), f"parameters/{name}.yaml: robot"
    )


def read_parameters(name: str, part: str = "values") -> dict[str, Any]:
    """Values by dotted name from the set `config/parameters/<name>.yaml`; raises ConfigError.

    part: `values`, which every set has, or those that a set may have instead of those of the
    `robot` in robot.yaml, of the `servo` in servo.yaml and of the `scene` that names the set.
    """
    return _part(config.load(f"parameters/{name}"), name, part)


def _part(content: Any, name: str, part: str) -> dict[str, Any]:
    """A part of the content of the set `name`; raises ConfigError."""
    given = content if isinstance(content, dict) else {}
    values = given.get(part, {} if part != "values" else None)
    if not isinstance(values, dict) or not all(
        isinstance(key, str) for key in values
    ):
        raise ConfigError(
            f"parameters/{name}.yaml: {part} is missing: a mapping of dotted names"
        )
    return values


def _insert(
    mapping: dict[str, Any], dotted: str, value: Any, source: str
) -> None:
    """Set the value at a dotted name; raises ConfigError if it is set or its parent is unknown."""
    *parents, last = dotted.split(".")
    for parent in parents:
        mapping = mapping.get(parent, {})
        if not isinstance(mapping, dict):
            raise ConfigError(f"{source}: {dotted} is not a setting")
    if last in mapping:
        raise ConfigError(
            f"{source}: {dotted} is set in robot.yaml too; set it in one of the two"
        )
    mapping[last] = value


def arc_length(nodes: Array) -> Array:
    """(N,) m from the first of nodes (N, 3) along the line through them."""
    return np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))]
    )


def at_shares(nodes: Array, values: Array | None = None) -> Array:
    """(4, 3) values (N, 3) at LEG_POINTS of a leg of nodes (N, 3); by default their places."""
    arc = arc_length(nodes)
    shares = np.array(list(LEG_POINTS.values())) * arc[-1]
    columns = (nodes if values is None else values).T
    return np.column_stack(
        [np.interp(shares, arc, column) for column in columns]
    )
