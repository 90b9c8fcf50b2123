"""Legs in space: equations of motion from an independent energy, conservation, torsion.

The torso: rotation compared with SciPy's, corners, pushes and payloads by hand.
"""

import numpy as np
import pytest
from leg_energy import (
    chain_strains,
    directions,
    elastic_energy,
    mass_matrix,
    masses,
    robot_energy,
)
from numba import njit
from rod_robots import FLOATING, ROBOT, UNDAMPED, simulator
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.dynamics.algebra import rotation
from slot_core.dynamics.model import build_floor
from slot_core.dynamics.rod import discretise
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.torso import add_corners, box
from slot_core.robot import GRAVITY
from slot_core.section import torsion_constant

PLACE = [0.04, -0.03, 0.05]  # m


def robot_momentum(sim):
    """Momentum, kg m/s, and angular momentum about odom's origin, kg m^2/s, of a robot (2, 3)."""
    rod, (mass, place, velocity) = sim.model.rod, masses(sim)
    angular = mass @ np.cross(place, velocity)
    angular += sim.rotation @ sim.model.torso.inertia @ sim.angular_velocity
    nodes, moving, *_ = sim._observe()
    arms = np.cross(np.diff(nodes, axis=1), np.diff(moving, axis=1))
    angular -= (rod.coupling @ arms).sum(axis=0)
    for swirl, axes in zip(sim.state.swirl, sim.model.axes):
        angular += sim.rotation @ axes.T @ (rod.spin @ swirl)
    return np.array([mass @ velocity, angular])


def kicked(robot=ROBOT, **changes):
    """A floating robot whose legs are struck sideways and downwards and set to twist."""
    sim = simulator(robot=robot, **FLOATING | changes)
    sim.set_motion(np.array([0.3, 0.2, 0.1]), np.array([3.0, 4.0, 5.0]))
    state, part = sim.state, sim.model.rod.arc / sim.model.rod.arc[-1]
    state.node_velocity[:, :, 1] += (
        1.5 * part**2 * np.array([[1.0], [-1.0], [0.5], [0.7]])
    )
    state.node_velocity[:, :, 2] += 0.5 * part**2
    along = np.diff(state.node, axis=1)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    rate = np.einsum(
        "lki,lki->lk",
        along,
        np.cross(along, np.diff(state.node_velocity, axis=1)),
    )
    state.swirl[:] = (rate + 20.0 * part[1:])[..., None] * along
    return sim


def test_a_step_solves_the_equations_of_motion_of_an_independent_energy():
    """Backward Euler: mass times change of velocity over h is minus the gradient at the end."""
    h, leg = 1e-3, 1
    step = {"solver__step": h, "solver__theta": 1.0, "solver__iterations": 12}
    sim = kicked(UNDAMPED, servo="ideal", solver__nodes=6, **step)
    sim.state.tendon_angle[:] = 1.0
    sim.advance(40, np.full(4, 1.0))  # bends, twists and pulls the legs
    before = sim._observe()[1][leg].copy()
    swirl = sim.state.swirl[leg] @ (sim.rotation @ sim.model.axes[leg].T).T
    sim.advance(1, np.full(4, 1.0))
    # leg axes to odom
    rod, turn = (sim.model.rod, sim.rotation @ sim.model.axes[leg].T)
    node, director = sim.nodes[leg], sim.state.director[leg] @ turn.T
    clamp = Rotation.from_matrix(turn)

    def energy(shift):
        """J, at nodes shifted by (6, 3), m, and segments turned by (5,), rad, all flat."""
        moved, twist = node + shift[:18].reshape(6, 3), shift[18:]
        found, _ = chain_strains(rod, clamp, node, director, moved, twist)
        return elastic_energy(sim.model, 1.0, *found)

    force = np.array([energy(-e) - energy(e) for e in 1e-6 * np.eye(23)]) / 2e-6
    change = mass_matrix(rod) @ (sim._observe()[1][leg] - before) / h
    spin = sim.state.swirl[leg] @ turn.T - swirl
    t, couple = directions(node), rod.spin[:, None] * spin / h
    across = (
        np.cross(couple, t)
        / np.linalg.norm(np.diff(node, axis=0), axis=1)[:, None]
    )
    # the gyroscopic couple of the spins acts through the nodes
    change[:-1] -= across
    change[1:] += across
    assert np.ptp(node @ sim.rotation[:, 1]) > 1e-3
    # Forces of some newtons; differences of an energy of 1 J leave 1e-9 / 1e-6.
    np.testing.assert_allclose(change[1:].ravel(), force[3:18], atol=2e-3)
    np.testing.assert_allclose(
        np.einsum("ki,ki->k", couple, t), force[18:], atol=2e-5
    )


@pytest.mark.parametrize(
    ("load", "most"),
    [({}, 1e-6), ({"payload__mass": 0.8, "payload__place": PLACE}, 1e-4)],
)
def test_momentum_is_conserved_to_second_order_while_the_tendons_pull(
    load, most
):
    """For a payload off the centre the rotation within a step is not exact."""
    solver, errors = {"solver__theta": 0.5, "solver__iterations": 6}, []
    for step in (2e-3, 1e-3):
        sim = kicked(solver__step=step, **solver, **load)
        before = robot_momentum(sim)
        sim.advance(round(0.4 / step), np.full(4, 1.5))
        change = np.linalg.norm(robot_momentum(sim) - before, axis=1)
        errors.append(change / np.linalg.norm(before, axis=1))
    assert np.max(errors[0]) < most
    # without a load the linear momentum is conserved to rounding
    assert (np.log2(errors[0] / errors[1])[0 if load else 1 :] > 1.9).all()


def test_energy_of_undamped_legs_is_conserved_in_flight():
    solver, errors = {"solver__theta": 0.5, "solver__iterations": 6}, []
    for step in (1e-3, 5e-4):
        sim = kicked(UNDAMPED, solver__step=step, **solver)
        before = robot_energy(sim)
        sim.advance(round(0.2 / step), np.zeros(4))
        errors.append(abs(robot_energy(sim) / before - 1))
    assert errors[0] < 1e-4
    # 2 in the limit; the stiff modes converge last
    assert np.log2(errors[0] / errors[1]) > 1.5


def test_a_motion_in_the_planes_of_the_legs_stays_in_them():
    sim = simulator(start__settle=0.0)
    for k in range(60):
        sim.advance(10, np.full(4, min(1.1, 0.03 * k)))
        assert np.abs(sim.state.node[:, :, 1]).max() < 1e-9  # m
    assert sim.position[2] > 0.035  # m: it has stood up


@pytest.mark.parametrize(
    ("width", "thickness", "factor"),
    [(1.0, 1.0, 0.1406), (2.0, 1.0, 0.229), (10.0, 1.0, 0.312)],
)
def test_torsion_constants_of_rectangles_are_the_tabulated_ones(
    width, thickness, factor
):
    """J = factor a b^3, Timoshenko and Goodier, Theory of Elasticity, art. 109, three digits."""
    assert torsion_constant(width, thickness) == pytest.approx(
        factor * width * thickness**3, abs=6e-4 * width * thickness**3
    )
    assert torsion_constant(thickness, width) == pytest.approx(
        torsion_constant(width, thickness)
    )


ROD = discretise(ROBOT.leg, 10, 2 / 3)
FLOOR = build_floor(read_scene("flat").floor, ROD, ROBOT.leg.contact_width)


@njit
def rotate(out, w):
    rotation(out, w)


@njit
def corners(H, g, torso, floor, pose):
    zero, held = np.zeros(3), (np.zeros((8, 3)), np.zeros(8), np.zeros((8, 2)))
    add_corners(
        H, g, torso, floor, 1.0, pose[0], pose[1], zero, zero, zero, held
    )


@pytest.mark.parametrize("size", [0.0, 1e-6, 9e-3, 1.1e-2, 1.0, 3.0])
def test_rotation_matches_scipy(size):
    vector, out = size * np.array([2.0, -3.0, 6.0]) / 7.0, np.zeros((3, 3))
    rotate(out, vector)
    np.testing.assert_allclose(
        out, Rotation.from_rotvec(vector).as_matrix(), atol=3e-16
    )


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
    np.testing.assert_allclose(
        H[:3, :3], 4e4 * np.outer(up, up), rtol=1e-9, atol=1e-9
    )


def test_a_push_changes_momentum_and_angular_momentum_by_its_impulses():
    """Its moment acts about odom's axes at any orientation; its force has a moment about odom."""
    force, moment, errors = (
        np.array([3.0, -4.0, 5.0]),
        np.array([0.3, 0.2, -0.1]),
        [],
    )
    for step in (2e-3, 1e-3):
        solver = {
            "solver__step": step,
            "solver__theta": 0.5,
            "solver__iterations": 6,
        }
        sim = simulator(**FLOATING, **solver)
        sim.set_motion(np.zeros(3), np.array([1.0, 2.0, 3.0]))
        (linear, angular), expected = robot_momentum(sim), np.zeros(3)
        sim.push(force, moment)
        for _ in range(round(0.2 / step)):
            start = sim.position
            sim.advance(1, np.full(4, 1.0))
            expected += step * (
                np.cross((start + sim.position) / 2, force) + moment
            )
        np.testing.assert_allclose(
            robot_momentum(sim)[0] - linear, 0.2 * force, rtol=1e-12
        )
        errors.append(
            np.linalg.norm(robot_momentum(sim)[1] - angular - expected)
        )
    assert errors[0] < 1e-5 * np.linalg.norm(expected)
    # second order, with the middle of each step
    assert np.log2(errors[0] / errors[1]) > 1.9


def test_the_forces_of_the_feet_balance_an_eccentric_payload():
    """Moments of the feet's forces about the centre of mass cancel; they act at the tips."""
    mass, place = 0.5, np.array([-0.03, 0.02, 0.03])
    # a tip is nearly one point
    narrow = config.replace(ROBOT, {"leg.contact_width": 1e-4})
    floor = {"floor__contact": "tip", "floor__friction_law": "bristle"}
    load = {"payload__mass": mass, "payload__place": place.tolist()}
    start = {"start__settle": 4.0, "start__tendon_angle_deg": 90.0}
    sim = simulator(narrow, "pid", **floor, **load, **start)
    sim.advance(6000, sim.tendon_angle)
    masses, nodes, force = sim.model.rod.mass, sim.nodes, sim.ground_force
    weight = sim.parameters.weight + mass * GRAVITY
    # measured: 2.8e-4; the legs still oscillate
    np.testing.assert_allclose(
        force.sum(0), [0.0, 0.0, weight], atol=5e-4 * weight
    )
    centre = ROBOT.torso.mass * sim.position + np.einsum(
        "n,lni->i", masses, nodes
    )
    centre += mass * (sim.position + sim.rotation @ place)
    centre /= ROBOT.torso.mass + mass + 4 * masses.sum()
    moment = np.cross(nodes[:, -1] - centre, force).sum(0)
    # the weight on an arm of 0.1 m
    np.testing.assert_allclose(moment, 0.0, atol=1e-5 * weight)
    # the payload has an effect
    assert np.abs(force[:, 2] - force[:, 2].mean()).max() > 0.3
