"""Model, state and scratch space of the kernels, built from the robot, its servos and the scene."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slot_core.dynamics.contact import Floor
from slot_core.dynamics.rod import Rod, Segments, discretise, segments
from slot_core.dynamics.scene import FloorSettings, Scene, SolverSettings
from slot_core.dynamics.servo import Servo, ServoSettings, servo
from slot_core.dynamics.tendon import TendonModel, route
from slot_core.dynamics.terrain import read_terrain
from slot_core.dynamics.torso import TorsoModel, box
from slot_core.robot import Array, Robot


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
    torso: TorsoModel
    floor: Floor
    servo: Servo
    friction: Array  # (2, 4) coefficient of the legs, and its other value where it varies
    gravity: Array  # (3,) m/s^2, odom
    axes: Array  # (4, 3, 3) base_link to leg axes
    root: Array  # (4, 3) m, clamp from the torso's centre, leg axes
    clamp: Array  # (4, 6, 6) torso increments to the displacements (X, phi, q) of a clamp
    speed_limit: float  # m/s
    payload: Array  # (4,) mass, kg, and position, m, base_link
    push: Array  # (6,) N and N m, odom, about the torso's centre
    fault: Array  # (2, 4) additional slack, m; 1, or 0 for a broken tendon


class MechanicalState(NamedTuple):
    """State of the robot: views of one buffer, written in place by the kernels."""

    buffer: Array  # all state variables
    position: Array  # (3,) m, odom
    rotation: Array  # (3, 3) base_link to odom
    velocity: Array  # (3,) m/s, odom
    rate: Array  # (3,) rad/s, base_link
    specific_force: Array  # (3,) m/s^2, base_link, mean over the last step
    node: Array  # (4, N, 2) m from the clamp, leg axes (x, z)
    node_velocity: Array  # (4, N, 3) m/s, absolute, leg axes
    tendon_angle: Array  # (4,) rad
    tendon_rate: Array  # (4,) rad/s, over the last step
    tension: Array  # (4,) N, at the stage of the last step
    drive: Array  # (4, 3) state of the servos, see `servo.spool_rate`
    bristle: Array  # (4, N, 3) m, odom, and (8, 3) of the torso's corners; empty without bristles
    corner_bristle: Array


class LegModel(NamedTuple):
    """Parameters, state views and scratch arrays of one leg in leg axes; no step allocates memory.

    The arrays of four legs have one axis more, the last (`lanes.py`). "Step axes" are those of
    `integrator.py`.
    """

    axes: Array  # (3, 3) base_link to leg axes
    root: Array  # (3,) m, clamp from the torso's centre
    clamp: Array  # (6, 6) torso increments to the displacements (X, phi, q) of the clamp
    friction: Array  # (2,) as in Model
    fault: Array  # (2,) as in Model
    node: Array  # (N, 2), node_velocity (N, 3), angle, rate, tension (1,): views of the state
    node_velocity: Array
    angle: Array
    rate: Array
    tension: Array
    drive: Array  # (3,), bristle (N or 0, 3): views of the state
    bristle: Array
    command: Array  # (1,) rad, commanded tendon angle
    stage: Array  # (N, 2) m, node at the stage
    velocity: Array  # (N, 3) m/s, V
    before: Array  # (N, 3) m/s, V_n in step axes
    base: Array  # (N, 2) m, stage position without the part due to V
    segments: Segments
    form: Array  # (7, 8) F
    rest: Array  # (4, 5) form over (q, lambda | 1), upper half
    moved: Array  # (6,) displacements of the clamp
    back: Array  # (N-1, 2, 8) rows for the substitution
    pull: Array  # (1,) N, tension at the iterate
    line: Array  # (3,) direction and 1 / length of a straight tendon
    limit: Array  # (N or 0,) N, mu times the normal force
    slope: Array  # (N or 0, 2) of the floor below
    release: Array  # (7,) lambda = release . (displacements of the clamp, 1)
    reduced: Array  # (6, 7) form over the displacements of the clamp
    product: Array  # (6, 6)
    turns: Array  # (3, 3) rotation by -(1 - theta) h omega_n
    whole: Array  # (3, 3) scratch rotations
    back_turn: Array  # (3, 3)
    forth: Array  # (3, 3)
    motion: Array  # (3, 3) torso in leg axes: v, omega, theta h (omega - omega_n)
    field: Array  # (4, 3) odom's axes and gravity in leg axes


class Work(NamedTuple):
    """Scratch space of the torso. "Step axes" are those of `integrator.py`."""

    matrix: Array  # (6, 6)
    vector: Array  # (6,)
    turn: Array  # (3, 3) scratch rotations
    next: Array  # (3, 3)
    rotation: Array  # (3, 3) step axes to odom
    motion: Array  # (5, 3) torso in step axes: v, omega, theta h (omega - omega_n), v_n, omega_n
    field: Array  # (4, 3) odom's axes and gravity in step axes
    limit: Array  # (8,) N, mu times the normal force of the corners
    slope: Array  # (8, 2) of the floor below the corners
    counter: Array  # (3,) halvings, steps with a pivot not positive, steps with no halving left


def state_space(nodes: int, bristles: bool = False) -> MechanicalState:
    """A state with N nodes per leg, all zero. The legs are the last axis in memory."""
    held, corners = (nodes, 8) if bristles else (0, 0)
    shapes: list[tuple[int, ...]] = [(3,), (3, 3), (3,), (3,), (3,), (nodes, 2, 4), (nodes, 3, 4)]
    shapes += [(4,), (4,), (4,), (3, 4), (held, 3, 4), (corners, 3)]
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    buffer = np.zeros(ends[-1])
    parts = np.split(buffer, ends[:-1])
    views = [part.reshape(shape) for part, shape in zip(parts, shapes)]
    views[5:7] = [view.transpose(2, 0, 1) for view in views[5:7]]
    views[10], views[11] = views[10].T, views[11].transpose(2, 0, 1)
    return MechanicalState(buffer, *views)


def leg_space(nodes: int, lanes: tuple[int, ...] = (), bristles: bool = False) -> LegModel:
    """Arrays of one leg of N nodes, or of four with the axis `lanes` = (4,); zero, not broken."""
    n, held = nodes - 1, nodes if bristles else 0
    shapes: list[tuple[int, ...]] = [(3, 3), (3,), (6, 6), (2,), (2,), (nodes, 2), (nodes, 3)]
    shapes += [(1,), (1,), (1,), (3,), (held, 3), (1,), (nodes, 2), (nodes, 3), (nodes, 3)]
    shapes += [(nodes, 2), (), (7, 8), (4, 5), (6,), (n, 2, 8), (1,), (3,), (held,), (held, 2)]
    shapes += [(7,), (6, 7), (6, 6), *[(3, 3)] * 5, (4, 3)]
    space = [np.zeros(shape + lanes) if shape else segments(nodes, lanes) for shape in shapes]
    legs = LegModel(*space)  # type: ignore[arg-type]
    legs.fault[1] = 1.0  # nothing is broken
    return legs


def leg_lanes(model: Model, state: MechanicalState) -> LegModel:
    """The four legs of a robot in lanes; their state arrays are views of `state`."""
    legs = leg_space(len(model.rod.node), (4,), state.bristle.shape[1] > 0)
    legs.axes[:] = model.axes.transpose(1, 2, 0)
    legs.root[:] = model.root.T
    legs.clamp[:] = model.clamp.transpose(1, 2, 0)
    return legs._replace(
        friction=model.friction,
        fault=model.fault,
        node=state.node.transpose(1, 2, 0),
        node_velocity=state.node_velocity.transpose(1, 2, 0),
        angle=state.tendon_angle[None],
        rate=state.tendon_rate[None],
        tension=state.tension[None],
        drive=state.drive.T,
        bristle=state.bristle.transpose(1, 2, 0),
    )


def work_space() -> Work:
    """Scratch space for the torso."""
    shapes = [(6, 6), (6,), (3, 3), (3, 3), (3, 3), (5, 3), (4, 3), (8,), (8, 2), (3,)]
    return Work(*(np.zeros(shape) for shape in shapes))


def clamp_maps(axes: Array, root: Array) -> Array:
    """(4, 6, 6) from the torso's increments (shift, turn; base_link) to a clamp's (X, phi, q)."""
    maps = np.zeros((4, 6, 6))
    for out, a, (rx, ry, rz) in zip(maps, axes, root):
        shift, turn = np.hstack([a, np.zeros((3, 3))]), np.hstack([np.zeros((3, 3)), a])
        out[0] = shift[0] + turn[1] * rz - turn[2] * ry
        out[1] = shift[2] + turn[0] * ry - turn[1] * rx
        out[2] = -turn[1]
        out[3], out[4], out[5] = shift[1], turn[0], turn[2]
    return maps


def build_model(robot: Robot, scene: Scene, settings: ServoSettings) -> Model:
    """Parameters of the kernels for a robot, its scene and its servos.

    Raises ConfigError for a height map that cannot be read, and for a supply voltage beyond those
    of the servos.
    """
    c, s = np.cos(robot.azimuth), np.sin(robot.azimuth)
    zero, one = np.zeros(4), np.ones(4)
    axes = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]]).transpose(2, 0, 1).copy()
    root = np.einsum("lij,lj->li", axes, robot.clamps)
    rod = discretise(robot.leg, scene.solver.nodes, robot.tendon.end_fraction)
    payload = scene.payload
    return Model(
        rod=rod,
        tendon=route(rod, robot.tendon),
        torso=box(robot.torso),
        floor=build_floor(scene.floor, rod),
        servo=servo(settings, scene.supply_voltage),
        friction=np.array([scene.floor.friction, scene.floor.friction_other]),
        gravity=np.array(scene.gravity),
        axes=axes,
        root=root,
        clamp=clamp_maps(axes, root),
        speed_limit=scene.solver.speed_limit,
        payload=np.array([payload.mass, *payload.place]),
        push=np.zeros(6),
        fault=np.array([scene.tendons.slack, np.logical_not(scene.tendons.broken)], dtype=float),
    )


def build_floor(settings: FloorSettings, rod: Rod) -> Floor:
    """Parameters of the contact law, with stiffness and damping per node of a rod.

    Raises ConfigError for a height map that cannot be read.
    """
    step = np.diff(rod.arc)
    line = settings.line_stiffness * (step[:-1] + step[1:]) / 2
    # The clamp is in the torso, whose corners touch the floor.
    stiffness = np.array([0.0, *line, settings.stiffness])
    tip_only = settings.contact == "tip"
    if tip_only:
        stiffness[:-1] = 0.0
    return Floor(
        stiffness=stiffness,
        damping=stiffness * (settings.damping / settings.stiffness),
        first=len(stiffness) - 1 if tip_only else 1,
        corner_stiffness=settings.stiffness,
        corner_damping=settings.damping,
        corner_friction=settings.torso_friction,
        friction_velocity=settings.friction_velocity,
        varies=("uniform", "direction", "phase").index(settings.friction_varies),
        bristle=settings.bristle if settings.friction_law == "bristle" else 0.0,
        terrain=read_terrain(settings.height_map, settings.spacing),
    )


def build_scheme(solver: SolverSettings, floor: Floor) -> ThetaScheme:
    """Parameters of the time integration.

    A position error d of a node in a contact of stiffness k is an energy of up to k d^2 / 2. The
    limit of the correction, d = sqrt(2 E / k), follows from the limit of that energy.
    """
    stiffest = max(floor.stiffness.max(), floor.corner_stiffness)
    return ThetaScheme(
        step=solver.step,
        theta=solver.theta,
        iterations=solver.iterations,
        halvings=solver.halvings,
        correction_limit=math.sqrt(2.0 * solver.correction_limit / stiffest),
    )


def rest_state(model: Model, height: float) -> MechanicalState:
    """Natural legs, slack tendons, level torso at a height (m), everything at rest."""
    state = state_space(len(model.rod.node), model.floor.bristle > 0.0)
    state.position[2] = height
    state.rotation[:] = np.eye(3)
    state.node[:] = model.rod.node
    return state
