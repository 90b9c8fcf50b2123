"""The robot in its scene as numbers: model, state and scratch space of the kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slot_core.dynamics.contact import Floor
from slot_core.dynamics.rod import Rod, Segments, discretise, segments
from slot_core.dynamics.scene import Scene, SolverSettings
from slot_core.dynamics.servo import Servo, ServoSettings, servo
from slot_core.dynamics.tendon import Tendon, route
from slot_core.dynamics.torso import Torso, box
from slot_core.robot import Array, Robot


class Scheme(NamedTuple):
    """Numbers of the time stepping."""

    step: float  # s, h
    theta: float
    iterations: int
    halvings: int
    correction_limit: float  # m/s


class Model(NamedTuple):
    """The robot and its scene as numbers; legs are equal and in the order FL FR RL RR."""

    rod: Rod
    tendon: Tendon
    torso: Torso
    floor: Floor
    servo: Servo
    friction: Array  # (5,) of the legs and of the torso
    gravity: Array  # (3,) m/s^2, odom
    axes: Array  # (4, 3, 3) base_link to leg axes
    root: Array  # (4, 3) m, clamp from the torso's centre, leg axes
    clamp: Array  # (4, 6, 6) torso increments to the displacements (X, phi, q) of a clamp
    speed_limit: float  # m/s


class State(NamedTuple):
    """The robot's state, views of one buffer; the kernels write it in place."""

    buffer: Array  # all of it
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


class Leg(NamedTuple):
    """All that a step needs of one leg, in leg axes; no step allocates memory.

    The arrays of four legs have one axis more, the last (`lanes.py`). "Step axes" are those of
    `integrator.py`.
    """

    axes: Array  # (3, 3) base_link to leg axes
    root: Array  # (3,) m, clamp from the torso's centre
    clamp: Array  # (6, 6) torso increments to the displacements (X, phi, q) of the clamp
    friction: Array  # (1,)
    node: Array  # (N, 2), node_velocity (N, 3), angle, rate, tension (1,): views of the state
    node_velocity: Array
    angle: Array
    rate: Array
    tension: Array
    command: Array  # (1,) rad, tendon angle asked for
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
    release: Array  # (7,) lambda = row . (displacements of the clamp, 1)
    reduced: Array  # (6, 7) form over the displacements of the clamp
    product: Array  # (6, 6)
    turns: Array  # (3, 3) rotation by -(1 - theta) h omega_n
    whole: Array  # (3, 3) scratch rotations
    back_turn: Array  # (3, 3)
    forth: Array  # (3, 3)
    motion: Array  # (3, 3) torso: v, omega, turn
    field: Array  # (2, 3) floor's normal and gravity


class Work(NamedTuple):
    """Scratch space of the torso. "Step axes" are those of `integrator.py`."""

    matrix: Array  # (6, 6)
    vector: Array  # (6,)
    turn: Array  # (3, 3) scratch rotations
    next: Array  # (3, 3)
    rotation: Array  # (3, 3) step axes to odom
    motion: Array  # (5, 3) torso in step axes: v, omega, theta h (omega - omega_n), v_n, omega_n
    field: Array  # (2, 3) floor's normal and gravity in step axes
    counter: Array  # (2,) halvings, steps with a pivot that was not positive


def state_space(nodes: int) -> State:
    """A state of legs of N nodes, all zero. The legs are the last axis in memory."""
    shapes = [(3,), (3, 3), (3,), (3,), (3,), (nodes, 2, 4), (nodes, 3, 4), (4,), (4,), (4,)]
    ends = np.cumsum([np.prod(shape) for shape in shapes])
    buffer = np.zeros(ends[-1])
    parts = np.split(buffer, ends[:-1])
    views = [part.reshape(shape) for part, shape in zip(parts, shapes)]
    views[5:7] = [view.transpose(2, 0, 1) for view in views[5:7]]
    return State(buffer, *views)


def leg_space(nodes: int, lanes: tuple[int, ...] = ()) -> Leg:
    """A leg of N nodes, or with the axis `lanes` = (4,) four; all zero."""
    n = nodes - 1
    shapes = [(3, 3), (3,), (6, 6), (1,), (nodes, 2), (nodes, 3), (1,), (1,), (1,), (1,)]
    shapes += [(nodes, 2), (nodes, 3), (nodes, 3), (nodes, 2), (), (7, 8), (4, 5), (6,), (n, 2, 8)]
    shapes += [(1,), (7,), (6, 7), (6, 6), (3, 3), (3, 3), (3, 3), (3, 3), (3, 3), (2, 3)]
    space = [np.zeros(shape + lanes) if shape else segments(nodes, lanes) for shape in shapes]
    return Leg(*space)  # type: ignore[arg-type]


def leg_lanes(model: Model, state: State) -> Leg:
    """The four legs of a robot in lanes, on its state."""
    legs = leg_space(len(model.rod.node), (4,))
    legs.axes[:] = model.axes.transpose(1, 2, 0)
    legs.root[:] = model.root.T
    legs.clamp[:] = model.clamp.transpose(1, 2, 0)
    legs.friction[0] = model.friction[:4]
    return legs._replace(
        node=state.node.transpose(1, 2, 0),
        node_velocity=state.node_velocity.transpose(1, 2, 0),
        angle=state.tendon_angle[None],
        rate=state.tendon_rate[None],
        tension=state.tension[None],
    )


def work_space() -> Work:
    """Scratch space for the torso."""
    shapes = [(6, 6), (6,), (3, 3), (3, 3), (3, 3), (5, 3), (2, 3), (2,)]
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
    """The numbers of the kernels."""
    c, s = np.cos(robot.azimuth), np.sin(robot.azimuth)
    zero, one = np.zeros(4), np.ones(4)
    axes = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]]).transpose(2, 0, 1).copy()
    root = np.einsum("lij,lj->li", axes, robot.clamps)
    rod = discretise(robot.leg, scene.solver.nodes)
    floor = scene.floor
    return Model(
        rod=rod,
        tendon=route(rod, robot.tendon),
        torso=box(robot.torso),
        floor=Floor(floor.stiffness, floor.damping, floor.friction_velocity),
        servo=servo(settings),
        friction=np.array([*floor.friction, floor.torso_friction]),
        gravity=np.array(scene.gravity),
        axes=axes,
        root=root,
        clamp=clamp_maps(axes, root),
        speed_limit=scene.solver.speed_limit,
    )


def build_scheme(solver: SolverSettings) -> Scheme:
    """The numbers of the time stepping."""
    return Scheme(
        step=solver.step,
        theta=solver.theta,
        iterations=solver.iterations,
        halvings=solver.halvings,
        correction_limit=solver.correction_limit,
    )


def rest_state(model: Model, height: float) -> State:
    """Natural legs, slack tendons, level torso at a height (m), everything at rest."""
    state = state_space(len(model.rod.node))
    state.position[2] = height
    state.rotation[:] = np.eye(3)
    state.node[:] = model.rod.node
    return state
