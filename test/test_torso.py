"""The torso against Euler's equations and plain linear algebra."""

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
from slot_core.dynamics.simulator import Simulator
from slot_core.dynamics.torso import add_corners, box
from slot_core.robot import read_robot

ROBOT = read_robot()
FLOOR = build_floor(read_scene("flat").floor, discretise(ROBOT.leg, 10, 2 / 3))


@njit
def rotate(out, w):
    rotation(out, w[0], w[1], w[2])


@njit
def solve_here(H, g):
    return solve(H, g)


@njit
def corners(H, g, torso, floor, pose):
    zero, held = np.zeros(3), (np.zeros((8, 3)), np.zeros(8), np.zeros((8, 2)))
    add_corners(H, g, torso, floor, 1.0, pose[0], pose[1], zero, zero, zero, held)


@pytest.mark.parametrize("size", [0.0, 1e-6, 9e-3, 1.1e-2, 1.0, 3.0])
def test_rotation_is_scipys(size):
    vector, out = size * np.array([2.0, -3.0, 6.0]) / 7.0, np.zeros((3, 3))
    rotate(out, vector)
    np.testing.assert_allclose(out, Rotation.from_rotvec(vector).as_matrix(), atol=3e-16)


def test_solve_is_numpys_and_knows_an_indefinite_matrix():
    root = np.random.default_rng(0).normal(size=(6, 6))
    matrix, right = root @ root.T + np.eye(6), np.arange(6.0)
    x = right.copy()
    assert solve_here(matrix.copy(), x)
    np.testing.assert_allclose(x, np.linalg.solve(matrix, -right), rtol=1e-10)
    assert not solve_here(matrix - 5.0 * np.eye(6), right.copy())


def test_corners_push_at_their_place():
    """Force, moment and stiffness of a box that dips one edge into the floor, by hand."""
    torso, floor = box(ROBOT.torso), FLOOR._replace(corner_damping=0.0, corner_friction=0.0)
    H, g = np.zeros((6, 6)), np.zeros(6)
    pitch = 0.02
    up, half = np.array([np.sin(-pitch), 0.0, np.cos(pitch)]), np.array(ROBOT.torso.size) / 2
    height = half[2]
    axes = np.array([np.cross([0.0, 1.0, 0.0], up), [0.0, 1.0, 0.0], up])
    corners(H, g, torso, floor, (np.array([0.0, 0.0, height]), axes))
    depth = -(height - np.sin(pitch) * half[0] - np.cos(pitch) * half[2])
    force = 2 * 2e4 * depth  # two corners
    np.testing.assert_allclose(-g[:3], force * up, rtol=1e-9)
    lever = np.cross([half[0], 0.0, -half[2]], up)  # the corners' mean
    np.testing.assert_allclose(-g[3:], force * lever, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(H[:3, :3], 4e4 * np.outer(up, up), rtol=1e-9, atol=1e-9)


def spinning(step, theta, angular_velocity, seconds):
    """A robot with legs as stiff as they get, floating and spinning."""
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
        },
    )
    sim = Simulator(dataclasses.replace(ROBOT, leg=leg), scene, read_servo())
    sim.set_motion(np.zeros(3), angular_velocity)
    inertia = np.zeros((3, 3))
    nodes = sim.nodes - sim.position
    for mass, points in zip(sim.model.rod.mass, nodes.transpose(1, 0, 2)):
        inertia += mass * (np.sum(points**2) * np.eye(3) - points.T @ points)
    centre = np.einsum("n,lni->i", sim.model.rod.mass, nodes)
    total = ROBOT.torso.mass + 4 * sim.model.rod.mass.sum()
    inertia += (
        ROBOT.torso.inertia - (centre @ centre * np.eye(3) - np.outer(centre, centre)) / total
    )
    sim.advance(round(seconds / step), np.zeros(4))
    return sim, inertia


def euler(inertia, start, seconds):
    """Orientation and angular velocity of a free rigid body, by an integrator of high order."""

    def derivative(_, y):
        spin = y[9:]
        turn = y[:9].reshape(3, 3) @ np.cross(np.eye(3), spin)
        return [*turn.ravel(), *np.linalg.solve(inertia, np.cross(inertia @ spin, spin))]

    y = solve_ivp(derivative, (0, seconds), [*np.eye(3).ravel(), *start], rtol=1e-11, atol=1e-12)
    return y.y[:9, -1].reshape(3, 3), y.y[9:, -1]


def test_a_stiff_robot_tumbles_by_eulers_equations():
    start = np.array([0.3, 4.0, 0.5])  # mostly about one axis, so that the others exchange
    sim, inertia = spinning(5e-4, 0.5, start, 1.0)
    orientation, spin = euler(inertia, start, 1.0)
    # Legs of 1e9 Pa still bend by some 1e-3 rad under the spin; the scheme adds (h w)^2 = 4e-6.
    np.testing.assert_allclose(sim.angular_velocity, spin, atol=0.02)
    np.testing.assert_allclose(sim.rotation, orientation, atol=0.01)
