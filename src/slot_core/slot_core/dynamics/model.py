"""Model, state and scratch space of the kernels, built from the robot, its servos and the scene."""

import math
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array, Arrays, Shapes, named, one_buffer, zeros
from slot_core.dynamics.contact import Floor, read_terrain
from slot_core.dynamics.rod import Rod, TendonModel, discretise, route
from slot_core.dynamics.scene import FloorSettings, Scene, SolverSettings
from slot_core.dynamics.servo import Servo, ServoSettings, servo
from slot_core.dynamics.spatial.leg import SpatialLeg, leg_shapes
from slot_core.dynamics.spatial.strain import segments
from slot_core.dynamics.torso import TorsoBox, box
from slot_core.elementary import cos, sin
from slot_core.robot import RobotParameters


class ThetaScheme(NamedTuple):
    """Parameters of the time integration."""

    step: float  # s, h
    theta: float
    iterations: int
    halvings: int
    correction_limit: float  # m, of a node in the last iteration


class Model(NamedTuple):
    """Parameters of the robot and its scene; the legs are equal and in the order FL FR RL RR."""

    rod: Rod
    tendon: TendonModel
    torso: TorsoBox
    floor: Floor
    servo: Servo
    friction: Array  # (2, 4) coefficient of the legs, and its other value where it varies
    gravity: Array  # (3,) m/s^2, odom
    axes: Array  # (4, 3, 3) base_link to leg axes
    root: Array  # (4, 3) m, clamp from the torso's centre, leg axes
    clamp: Array  # (4, 6, 6) torso increments to the displacements of a clamp
    speed_limit: float  # m/s
    payload: Array  # (4,) mass, kg, and position, m, base_link
    push: Array  # (6,) N and N m, odom, about the torso's centre
    fault: Array  # (2, 4) additional slack, m; 1, or 0 for a broken tendon


def state_shapes(nodes: int, points: int, relaxes: bool) -> Shapes:
    """State of a robot with N nodes and `points` contact points per leg; legs last in memory.

    relaxes: whether the legs have Maxwell branches. The kernels write the arrays in place.
    """
    n = nodes - 1
    return {
        "position": (3,),  # m, odom
        "rotation": (3, 3),  # base_link to odom
        "velocity": (3,),  # m/s, odom
        "rate": (3,),  # rad/s, base_link
        "specific_force": (3,),  # m/s^2, base_link, mean over the last step
        "node": (nodes, 3, 4),  # m from the clamp, leg axes
        "node_velocity": (nodes, 3, 4),  # m/s, absolute, leg axes
        # unit vectors along the width of the segments, leg axes
        "director": (n, 3, 4),
        # rad/s, angular momentum of their twist over its inertia, leg axes
        "swirl": (n, 3, 4),
        "tendon_angle": (4,),  # rad
        "tendon_rate": (4,),  # rad/s, over the last step
        "tension": (4,),  # N, at the stage of the last step
        "drive": (3, 4),  # state of the servos, see `servo.spool_rate`
        "bristle": (points, 3, 4),  # m, odom; zero with viscous friction
        "corner_bristle": (8, 3),  # of the torso's corners
        # strains of the branches (`spatial/strain.py`)
        "memory": (n if relaxes else 0, 4, 2, 4),
    }


MechanicalState = named(
    "MechanicalState", ["buffer", *state_shapes(1, 0, False)], __name__
)
"""State of a robot: `buffer` holds all variables, the other arrays are views of it."""
WORK: Shapes = {
    "matrix": (6, 6),
    "vector": (6,),
    "turn": (3, 3),  # scratch rotations
    "next": (3, 3),
    "rotation": (3, 3),  # step axes to odom
    # torso in step axes: v, omega, theta h (omega - omega_n), v_n, omega_n
    "motion": (5, 3),
    "field": (4, 3),  # odom's axes and gravity in step axes
    "limit": (8,),  # N, mu times the normal force of the corners
    "slope": (8, 2),  # of the floor below the corners
    # halvings, steps with a pivot not positive, steps with no halving left
    "counter": (3,),
}
"""Scratch space of the torso. `integrator.py` defines its "step axes"."""
Work = named("Work", WORK, __name__)
LEG_STATE = (
    "node",
    "node_velocity",
    "director",
    "swirl",
    "drive",
    "bristle",
    "memory",
)
"""Arrays of the state with one row for each leg; in memory the legs are the last axis."""


def state_space(
    nodes: int, points: int, relaxes: bool = False, lanes: tuple[int, ...] = ()
) -> Arrays:
    """A state of `state_shapes`, all zero.

    lanes: (4,) for four states side by side, then every array has that axis at its end.
    """
    shapes = state_shapes(nodes, points, relaxes)
    buffer, views = one_buffer({name: s + lanes for name, s in shapes.items()})
    for name in LEG_STATE:
        views[name] = np.moveaxis(views[name], -1 - len(lanes), 0)
    return MechanicalState(buffer.reshape(-1, *lanes), **views)


def spatial_leg(
    nodes: int, lanes: tuple[int, ...] = (), points: int = 0
) -> Arrays:
    """Arrays of one leg of N nodes, or of four with the axis `lanes` = (4,); zero, not broken."""
    arrays = zeros(leg_shapes(nodes, points), lanes)
    arrays["fault"][1] = 1.0  # nothing is broken
    return SpatialLeg(segments=segments(nodes, lanes), **arrays)


def leg_lanes(model: Model, state: Arrays) -> Arrays:
    """The four legs of a robot in lanes; their state arrays are views of `state`."""
    legs = spatial_leg(len(model.rod.node), (4,), state.bristle.shape[1])
    for name in ("axes", "root", "clamp"):
        getattr(legs, name)[:] = np.moveaxis(getattr(model, name), 0, -1)
    return legs._replace(
        friction=model.friction,
        fault=model.fault,
        angle=state.tendon_angle[None],
        rate=state.tendon_rate[None],
        tension=state.tension[None],
        **{
            name: np.moveaxis(getattr(state, name), 0, -1) for name in LEG_STATE
        },
    )


def work_space(lanes: tuple[int, ...] = ()) -> Arrays:
    """Scratch space for the torso, or for those of four states with the axis `lanes` = (4,)."""
    return Work(**zeros(WORK, lanes))


def clamp_maps(axes: Array, root: Array) -> Array:
    """(4, 6, 6) from the torso's increments (shift, turn; base_link) to (X, Phi) of a clamp."""
    maps = np.zeros((4, 6, 6))
    for out, a, (rx, ry, rz) in zip(maps, axes, root):
        shift, turn = (
            np.hstack([a, np.zeros((3, 3))]),
            np.hstack([np.zeros((3, 3)), a]),
        )
        out[0] = shift[0] + turn[1] * rz - turn[2] * ry
        out[1] = shift[1] + turn[2] * rx - turn[0] * rz
        out[2] = shift[2] + turn[0] * ry - turn[1] * rx
        out[3:] = turn
    return maps


def build_model(
    robot: RobotParameters, scene: Scene, settings: ServoSettings
) -> Model:
    """Parameters of the kernels for a robot, its scene and its servos.

    Raises ConfigError for a height map that cannot be read, and for a supply voltage beyond those
    of the servos.
    """
    c, s = cos(robot.azimuth), sin(robot.azimuth)
    zero, one = np.zeros(4), np.ones(4)
    axes = (
        np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]])
        .transpose(2, 0, 1)
        .copy()
    )
    root = (axes * robot.clamps[:, None]).sum(axis=-1)
    rod = discretise(robot.leg, scene.solver.nodes, robot.tendon.end_fraction)
    payload = scene.payload
    return Model(
        rod=rod,
        tendon=route(rod, robot.tendon),
        torso=box(robot.torso),
        floor=build_floor(scene.floor, rod, robot.leg.contact_width),
        servo=servo(settings, scene.supply_voltage)._replace(
            friction=robot.tendon.capstan
        ),
        friction=np.array([scene.floor.friction, scene.floor.friction_other]),
        gravity=np.array(scene.gravity),
        axes=axes,
        root=root,
        clamp=clamp_maps(axes, root),
        speed_limit=scene.solver.speed_limit,
        payload=np.array([payload.mass, *payload.place]),
        push=np.zeros(6),
        fault=np.array(
            [scene.tendons.slack, np.logical_not(scene.tendons.broken)],
            dtype=float,
        ),
    )


def build_floor(settings: FloorSettings, rod: Rod, width: float) -> Floor:
    """Parameters of the contact law, with stiffness and damping of the contact points of a rod.

    width: m, between the edges that touch. Raises ConfigError for a height map that cannot be read.
    """
    step = np.diff(rod.arc)
    # Of the line stiffness each segment has half at each end. The clamp is in the torso, whose
    # corners touch the floor.
    ends = np.repeat(settings.line_stiffness * step[:, None] / 2, 2, axis=1)
    ends[0, 0], ends[-1, 1] = 0.0, settings.stiffness
    tip_only = settings.contact == "tip"
    if tip_only:
        ends[:-1], ends[-1, 0] = 0.0, 0.0
    stiffness = np.repeat(ends.ravel() / 2, 2)  # of both edges
    return Floor(
        stiffness=stiffness,
        damping=stiffness * (settings.damping / settings.stiffness),
        first=len(step) if tip_only else 1,
        half_width=width / 2,
        corner_stiffness=settings.stiffness,
        corner_damping=settings.damping,
        corner_friction=settings.torso_friction,
        friction_velocity=settings.friction_velocity,
        varies=("uniform", "direction", "phase").index(
            settings.friction_varies
        ),
        bristle=settings.bristle if settings.friction_law == "bristle" else 0.0,
        terrain=read_terrain(settings.height_map, settings.spacing),
    )


def build_scheme(solver: SolverSettings, floor: Floor) -> ThetaScheme:
    """Parameters of the time integration.

    A position error d of a node in a contact of stiffness k is an energy of up to k d^2 / 2. The
    limit of the correction, d = sqrt(2 E / k), follows from the limit of that energy.
    """
    stiffest = max(2 * floor.stiffness.max(), floor.corner_stiffness)
    return ThetaScheme(
        step=solver.step,
        theta=solver.theta,
        iterations=solver.iterations,
        halvings=solver.halvings,
        correction_limit=math.sqrt(2.0 * solver.correction_limit / stiffest),
    )


def matching_state(model: Model) -> Arrays:
    """A state for the model's nodes, contact points and branches, all zero."""
    relaxes = bool(model.rod.relaxation[0].any())
    return state_space(len(model.rod.node), len(model.floor.stiffness), relaxes)


def rest_state(model: Model, height: float) -> Arrays:
    """Natural legs, slack tendons, level torso at a height (m), everything at rest."""
    state = matching_state(model)
    state.position[2] = height
    state.rotation[:] = np.eye(3)
    state.node[:, :, ::2] = model.rod.node
    state.director[:] = 0.0, -1.0, 0.0
    return state
