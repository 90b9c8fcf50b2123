"""Legs in space: equations of motion from an independent energy, conservation, torsion."""

import numpy as np
import pytest
from leg_energy import (
    chain_strains,
    directions,
    elastic_energy,
    mass_matrix,
    robot_energy,
    robot_momentum,
)
from rod_robots import FLOATING, ROBOT, UNDAMPED, simulator
from scipy.spatial.transform import Rotation

from slot_core.section import torsion_constant

PLACE = [0.04, -0.03, 0.05]  # m


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


@pytest.mark.parametrize("iterations", [1, 2])
def test_linear_momentum_is_conserved_to_rounding(iterations):
    sim = kicked(solver__iterations=iterations)
    before = robot_momentum(sim)[0]
    sim.advance(500, np.full(4, 1.5))
    np.testing.assert_allclose(robot_momentum(sim)[0], before, rtol=1e-12)


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
