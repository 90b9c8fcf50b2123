"""The torso compared with Euler's equations and NumPy's linear algebra."""

import dataclasses

import numpy as np
import pytest
from numba import njit
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.dynamics.algebra import rotation, solve
from slot_core.dynamics.model import build_floor
from slot_core.dynamics.rod import discretise
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.torso import add_corners, box
from slot_core.robot import read_robot
from slot_core.simulation.rod_robot import RodRobot

ROBOT = read_robot()
ROD = discretise(ROBOT.leg, 10, 2 / 3)
FLOOR = build_floor(read_scene("flat").floor, ROD, ROBOT.leg.contact_width)


@njit
def rotate(out, w):
    rotation(out, w)


@njit
def solve_here(H, g):
    return solve(H, g)


@njit
def corners(H, g, torso, floor, pose):
    zero, held = np.zeros(3), (np.zeros((8, 3)), np.zeros(8), np.zeros((8, 2)))
    add_corners(H, g, torso, floor, 1.0, pose[0], pose[1], zero, zero, zero, held)


@pytest.mark.parametrize("size", [0.0, 1e-6, 9e-3, 1.1e-2, 1.0, 3.0])
def test_rotation_matches_scipy(size):
    vector, out = size * np.array([2.0, -3.0, 6.0]) / 7.0, np.zeros((3, 3))
    rotate(out, vector)
    np.testing.assert_allclose(
        out, Rotation.from_rotvec(vector).as_matrix(), atol=3e-16
    )


def test_solve_matches_numpy_and_detects_an_indefinite_matrix():
    root = np.random.default_rng(0).normal(size=(6, 6))
    matrix, right = root @ root.T + np.eye(6), np.arange(6.0)
    x = right.copy()
    assert solve_here(matrix.copy(), x)
    np.testing.assert_allclose(x, np.linalg.solve(matrix, -right), rtol=1e-10)
    assert not solve_here(matrix - 5.0 * np.eye(6), right.copy())


def test_corner_forces_act_at_the_corners():
    """Force, moment and stiffness of a box with one edge below the floor, computed by hand."""
    torso, floor = (
        box(ROBOT.torso),
        FLOOR._replace(corner_damping=0.0, corner_friction=0.0),
    )
    H, g = np.zeros((6, 6)), np.zeros(6)
    pitch = 0.02
    up, half = (
        np.array([np.sin(-pitch), 0.0, np.cos(pitch)]),
        np.array(ROBOT.torso.size) / 2,
    )
    height = half[2]
    axes = np.array([np.cross([0.0, 1.0, 0.0], up), [0.0, 1.0, 0.0], up])
    corners(H, g, torso, floor, (np.array([0.0, 0.0, height]), axes))
    depth = -(height - np.sin(pitch) * half[0] - np.cos(pitch) * half[2])
    force = 2 * 2e4 * depth  # two corners
    np.testing.assert_allclose(-g[:3], force * up, rtol=1e-9)
    lever = np.cross([half[0], 0.0, -half[2]], up)  # the corners' mean
    np.testing.assert_allclose(-g[3:], force * lever, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(H[:3, :3], 4e4 * np.outer(up, up), rtol=1e-9, atol=1e-9)


def spinning(step, theta, angular_velocity, seconds, payload):
    """A floating, spinning robot with the stiffest legs allowed, and its inertia (3, 3).

    payload: mass, kg, and position, m.
    """
    leg = dataclasses.replace(ROBOT.leg, young_modulus=1e9)
    scene = config.replace(
        read_scene("flat"),
        {
            "gravity": [0.0, 0.0, 0.0],
            "start.height": 5.0,
            "start.settle": 0.0,
            "solver.nodes": 10,
            "solver.step": step,
            "solver.theta": theta,
            "payload.mass": payload[0],
            "payload.place": payload[1:],
        },
    )
    sim = RodRobot(dataclasses.replace(ROBOT, leg=leg), scene, read_servo())
    sim.set_motion(np.zeros(3), angular_velocity)
    inertia = np.zeros((3, 3))
    nodes, load = sim.nodes - sim.position, np.array(payload[1:])
    for mass, points in zip(sim.model.rod.mass, nodes.transpose(1, 0, 2)):
        inertia += mass * (np.sum(points**2) * np.eye(3) - points.T @ points)
    inertia += payload[0] * (load @ load * np.eye(3) - np.outer(load, load))
    centre = np.einsum("n,lni->i", sim.model.rod.mass, nodes) + payload[0] * load
    total = ROBOT.torso.mass + 4 * sim.model.rod.mass.sum() + payload[0]
    inertia += (
        ROBOT.torso.inertia
        - (centre @ centre * np.eye(3) - np.outer(centre, centre)) / total
    )
    sim.advance(round(seconds / step), np.zeros(4))
    return sim, inertia


def euler(inertia, start, seconds):
    """Orientation and angular velocity of a free rigid body, with a high-order integrator."""

    def derivative(_, y):
        spin = y[9:]
        turn = y[:9].reshape(3, 3) @ np.cross(np.eye(3), spin)
        return [
            *turn.ravel(),
            *np.linalg.solve(inertia, np.cross(inertia @ spin, spin)),
        ]

    y = solve_ivp(
        derivative, (0, seconds), [*np.eye(3).ravel(), *start], rtol=1e-11, atol=1e-12
    )
    return y.y[:9, -1].reshape(3, 3), y.y[9:, -1]


LOAD = (0.8, 0.04, -0.03, 0.05)  # mass, kg, and position, m


@pytest.mark.parametrize("payload", [(0.0, 0.0, 0.0, 0.0), LOAD])
def test_a_stiff_robot_tumbles_by_eulers_equations(payload):
    start = np.array([0.3, 4.0, 0.5])  # mostly about one axis; the others exchange spin
    sim, inertia = spinning(5e-4, 0.5, start, 1.0, payload)
    orientation, spin = euler(inertia, start, 1.0)
    # Legs of 1e9 Pa still bend by some 1e-3 rad under the spin; the scheme adds (h w)^2 = 4e-6.
    np.testing.assert_allclose(sim.angular_velocity, spin, atol=0.02)
    np.testing.assert_allclose(sim.rotation, orientation, atol=0.01)


def flying(step=1e-3, theta=0.5, **changes):
    """A robot without gravity, legs and tendons at rest."""
    changes = {name.replace("__", "."): value for name, value in changes.items()}
    changes |= {"gravity": [0.0, 0.0, 0.0], "start.height": 5.0, "start.settle": 0.0}
    changes |= {"solver.step": step, "solver.theta": theta, "solver.iterations": 6}
    return RodRobot(ROBOT, config.replace(read_scene("flat"), changes), read_servo())


def test_momentum_with_a_payload_is_conserved_while_the_tendons_pull():
    errors = []
    for step in (2e-3, 1e-3):
        sim = flying(step, payload__mass=LOAD[0], payload__place=LOAD[1:])
        sim.set_motion(np.array([0.3, 0.2, 0.1]), np.array([3.0, 4.0, 5.0]))
        before = sim.momentum()
        sim.advance(round(0.4 / step), np.full(4, 1.5))
        after = sim.momentum()
        # For a payload off the centre the rotation within a step is not exact.
        errors.append(
            [np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(after, before)]
        )
    assert np.max(errors[0]) < 1e-4
    assert (np.log2(np.array(errors[0]) / errors[1]) > 1.9).all()  # second order


def test_a_push_changes_momentum_by_its_impulse():
    sim, force = flying(theta=0.55), np.array([3.0, -4.0, 5.0])
    before = sim.momentum()[0]
    sim.push(force, np.zeros(3))
    sim.advance(100, np.full(4, 1.0))
    sim.push(-force, np.zeros(3))
    pushed = sim.momentum()[0]
    np.testing.assert_allclose(pushed - before, 0.1 * force, rtol=1e-12)
    sim.advance(100, np.full(4, 1.0))
    np.testing.assert_allclose(sim.momentum()[0], pushed, rtol=1e-12)


def test_a_push_changes_angular_momentum_by_its_angular_impulse():
    """Its moment acts about odom's axes at any orientation; its force has a moment about odom."""
    force, moment, errors = np.array([3.0, -4.0, 5.0]), np.array([0.3, 0.2, -0.1]), []
    for step in (2e-3, 1e-3):
        sim = flying(step)
        sim.set_motion(np.zeros(3), np.array([1.0, 2.0, 3.0]))
        before, expected = sim.momentum()[1], np.zeros(3)
        sim.push(force, moment)
        for _ in range(round(0.2 / step)):
            start = sim.position
            sim.advance(1, np.full(4, 1.0))
            expected += step * (np.cross((start + sim.position) / 2, force) + moment)
        errors.append(np.linalg.norm(sim.momentum()[1] - before - expected))
    assert errors[0] < 1e-5 * np.linalg.norm(expected)
    assert (
        np.log2(errors[0] / errors[1]) > 1.9
    )  # second order, with the middle of each step


def test_the_forces_of_the_feet_balance_an_eccentric_payload():
    """Moments of the feet's forces about the centre of mass cancel; they act at the tips."""
    mass, place = 0.5, np.array([-0.03, 0.02, 0.03])
    changes = {
        "floor.contact": "tip",
        "floor.friction_law": "bristle",
        "payload.mass": mass,
        "payload.place": place.tolist(),
        "start.settle": 4.0,
        "start.tendon_angle_deg": 90.0,
    }
    narrow = config.replace(
        ROBOT, {"leg.contact_width": 1e-4}
    )  # m, a tip is nearly one point
    sim = RodRobot(narrow, config.replace(read_scene("flat"), changes), read_servo())
    sim.advance(6000, sim.tendon_angle)
    masses, nodes = sim.model.rod.mass, sim.nodes
    centre = ROBOT.torso.mass * sim.position + mass * (
        sim.position + sim.rotation @ place
    )
    centre += np.einsum("n,lni->i", masses, nodes)
    centre /= ROBOT.torso.mass + mass + 4 * masses.sum()
    force = sim.ground_force
    moment = np.cross(nodes[:, -1] - centre, force).sum(0)
    scale = 0.1 * force[:, 2].sum()  # N m, the weight on an arm of 0.1 m
    np.testing.assert_allclose(moment, 0.0, atol=1e-4 * scale)
    assert (
        np.abs(force[:, 2] - force[:, 2].mean()).max() > 0.3
    )  # the payload has an effect
