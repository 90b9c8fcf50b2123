"""Settings and arrays of the paper's model; `paper_robot.py` gives its equations."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import quantity
from slot_core.dynamics.scene import Scene
from slot_core.robot import GRAVITY, RobotParameters


@dataclass(frozen=True)
class PaperSettings:
    """Settings of the paper's model: `config/paper.yaml`."""

    young_modulus: float = quantity("Young's modulus", "Pa", 1e4, 1e10)
    nodes: int = quantity("nodes of a leg", "", 4, 401)
    step: float = quantity("time step", "s", 1e-7, 1e-2)
    restoring_stiffness: float = quantity(
        "spring from each node to its initial position", "N/m", 0, 1e6
    )
    damping: float = quantity(
        "linear damping, N s/m of a node and N m s of its angle", "", 0.0, 1e3
    )
    contact_stiffness: float = quantity("contact stiffness of a node", "N/m", 0.0, 1e8)
    contact_damping: float = quantity("contact damping of a node", "N s/m", 0.0, 1e4)
    friction: float = quantity("Coulomb friction", "", 0.0, 5.0)
    servo_torque: float = quantity(
        "torque at the end of the servo's range", "N m", 0.0, 100.0
    )
    servo_range_deg: float = quantity("range of the servo", "deg", 1.0, 3600.0)
    tension_scale: float = quantity("factor of the robot's tensions", "", 0.0, 1.0)
    weight_share: float = quantity(
        "part of the torso's weight on each leg's base", "", 0.0, 1.0
    )
    torso_drag: float = quantity("horizontal damping of the torso", "N s/m", 0.0, 1e4)
    torso_stiffness: float = quantity("vertical spring of the torso", "N/m", 0.0, 1e6)
    torso_damping: float = quantity("vertical damping of the torso", "N s/m", 0.0, 1e5)
    speed_limit: float = quantity(
        "speed of a node above which the solution has diverged", "m/s", 1.0, 1e6
    )


def read_paper() -> PaperSettings:
    """The settings of `config/paper.yaml`; raises ConfigError."""
    return config.read(PaperSettings, "paper")


def tension_of(settings: PaperSettings, robot: RobotParameters, angle: Array) -> Array:
    """Tensions (N) at tendon angles (rad): T = (angle / range) torque / spool radius."""
    torque = angle / math.radians(settings.servo_range_deg) * settings.servo_torque
    return np.asarray(torque / robot.tendon.spool_radius)


class PaperLegModel(NamedTuple):
    """Numbers of a leg in its plane: x outward, z above the floor."""

    spacing: float  # m, dx: natural length of every segment
    gravity: float  # m/s^2, downwards
    restoring: float  # N/m, k_r
    damping: float  # N s/m and N m s, c
    contact_stiffness: float  # N/m
    contact_damping: float  # N s/m
    friction: float  # N, magnitude on every node that touches the floor
    base_load: float  # N, downwards on node 0
    touching: int  # first node that can touch the floor
    speed_limit: float  # m/s
    mass: Array  # (N,) kg
    inertia: Array  # (N,) kg m, rho A dx^2 / 2
    axial: Array  # (N-1,) N, E A
    bending: Array  # (N-1,) N m, E I / dx
    initial: Array  # (N, 2) m
    pull: Array  # (N, 3) force x, z and moment (m) per newton of tension


class PaperLegState(NamedTuple):
    """State of K legs."""

    node: Array  # (K, N, 2) m, x and z
    velocity: Array  # (K, N, 2) m/s
    angle: Array  # (K, N) rad; nothing depends on it
    rate: Array  # (K, N) rad/s; only the angle depends on it
    force: Array  # (K, 2) N, F_i: sum of the forces on node 0, x and z
    tension: Array  # (K,) N


class PaperTorso(NamedTuple):
    """Numbers of the torso."""

    mass: float  # kg
    drag: float  # N s/m, horizontal
    stiffness: float  # N/m, vertical
    damping: float  # N s/m, vertical
    height: float  # m, at which the vertical spring is relaxed
    mobility: Array  # (3, 3) 1/(kg m^2), inverse of the inertia
    clamps: Array  # (4, 3) m, base_link
    outward: Array  # (4, 3) x axes of the legs, base_link
    gravity: Array  # (3,) m/s^2, odom


class PaperTorsoState(NamedTuple):
    """Motion of the torso, and scratch rotations."""

    position: Array  # (3,) m, odom
    rotation: Array  # (3, 3) base_link to odom
    velocity: Array  # (3,) m/s, odom
    rate: Array  # (3,) rad/s, base_link
    specific_force: Array  # (3,) m/s^2, base_link, mean over the last step of the scene
    turn: Array  # (3, 3) scratch
    next: Array  # (3, 3) scratch


def leg_model(
    robot: RobotParameters,
    settings: PaperSettings,
    touching: int,
    base_load: float,
    gravity: float = GRAVITY,
) -> PaperLegModel:
    """Numbers of a leg.

    touching: first node that can touch the floor. base_load: downward force on the base, N.
    gravity: m/s^2, downwards.
    """
    leg, count = robot.leg, settings.nodes
    spacing = leg.reach / (count - 1)
    thickness = np.linspace(leg.thickness_clamp, leg.thickness_tip, count)
    area = leg.width * thickness
    second_moment = leg.width * thickness**3 / 12
    initial = _initial(robot, count)
    weight = (leg.mass + robot.mass / 4) * gravity
    return PaperLegModel(
        spacing=spacing,
        gravity=gravity,
        restoring=settings.restoring_stiffness,
        damping=settings.damping,
        contact_stiffness=settings.contact_stiffness,
        contact_damping=settings.contact_damping,
        friction=settings.friction * weight,
        base_load=base_load,
        touching=touching,
        speed_limit=settings.speed_limit,
        mass=_masses(leg.density * area * spacing),
        inertia=leg.density * area * spacing**2 / 2,
        axial=settings.young_modulus * area[:-1],
        bending=settings.young_modulus * second_moment[:-1] / spacing,
        initial=initial,
        pull=_pull(initial, thickness, int(robot.tendon.end_fraction * count)),
    )


def leg_state(model: PaperLegModel, legs: int) -> PaperLegState:
    """State of `legs` legs at rest in their initial shape."""
    count = len(model.mass)
    node = np.tile(model.initial, (legs, 1, 1))
    shapes = [(legs, count, 2), (legs, count), (legs, count), (legs, 2), (legs,)]
    return PaperLegState(node, *(np.zeros(shape) for shape in shapes))


def torso_model(
    robot: RobotParameters, scene: Scene, settings: PaperSettings
) -> PaperTorso:
    """Numbers of the torso; its vertical spring is relaxed at the scene's start height."""
    return PaperTorso(
        mass=robot.torso.mass,
        drag=settings.torso_drag,
        stiffness=settings.torso_stiffness,
        damping=settings.torso_damping,
        height=scene.start.height,
        mobility=np.diag(1.0 / np.diag(robot.torso.inertia)),
        clamps=robot.clamps,
        outward=robot.outward,
        gravity=np.array(scene.gravity),
    )


def torso_state(height: float) -> PaperTorsoState:
    """State of a level torso at rest at a height, m."""
    shapes = [(3,), (3, 3), (3,), (3,), (3,), (3, 3), (3, 3)]
    state = PaperTorsoState(*(np.zeros(shape) for shape in shapes))
    state.position[2] = height
    state.rotation[:] = np.eye(3)
    return state


def _initial(robot: RobotParameters, count: int) -> Array:
    """(N, 2) m, initial shape at equal distances in x."""
    x = np.linspace(0.0, robot.leg.reach, count)
    return np.column_stack([x, robot.leg.shape(x)])


def _masses(segment: Array) -> Array:
    """(N,) node masses, kg, from rho A_i dx (N,): means of i - 1 and i; half of it at the ends."""
    mass = segment.copy()
    mass[1:-1] = (segment[:-2] + segment[1:-1]) / 2
    mass[[0, -1]] /= 2
    return mass


def _pull(initial: Array, thickness: Array, end: int) -> Array:
    """(N, 3) force and moment (m) per newton of tension, along the normals before node `end`."""
    slope = np.gradient(initial, axis=0)
    normal = slope[:, ::-1] * [-1, 1] / np.hypot(*slope.T)[:, None]
    pull = np.column_stack([normal, -thickness / 2 * normal[:, 0]])
    pull[end:] = 0.0
    return pull
