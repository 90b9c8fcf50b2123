"""The soft leg compared with a tapered beam; equilibria and other beams are in test/rod.

Legs that relax, compared with the creep of a material with two Maxwell branches.
"""

import dataclasses

import numpy as np
import pytest
from leg_energy import mass_matrix, strains
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from slot_core import config
from slot_core.dynamics.rod import build, discretise
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.make_robot import make_robot
from slot_core.simulation.rod_robot import RodRobot

ROBOT = read_robot()
ANCHOR = 2 / 3  # of the length
LENGTH = 0.19


def lowest_frequencies(nodes, count):
    """Lowest natural frequencies of a straight tapered leg about its natural shape, Hz."""
    node = np.column_stack([np.linspace(0.0, LENGTH, nodes), np.zeros(nodes)])
    leg = dataclasses.replace(ROBOT.leg, young_modulus=1e7)
    rod = build(leg, node, node[:, 0], round((nodes - 1) * ANCHOR))
    springs = np.concatenate([rod.axial, rod.bending])

    def both(shift):
        return np.concatenate(strains(rod, node + shift), axis=-1)

    step = 1e-7 * np.eye(2 * nodes)[2:].reshape(-1, nodes, 2)
    change = (both(step) - both(-step)) / 2e-7
    mass = np.kron(mass_matrix(rod)[1:, 1:], np.eye(2))  # of the free nodes
    values = eigh((change * springs) @ change.T, mass, eigvals_only=True)
    return np.sqrt(values[:count]) / (2 * np.pi)


def test_tapered_leg_vibrates_at_the_frequencies_of_a_tapered_bernoulli_beam():
    """The weights of its hinges are those of fourth order on both sides of the anchor."""
    exact = np.array([6.5209720302, 25.5124367433, 61.3511026964])
    coarse, fine = (
        lowest_frequencies(nodes, 3) / exact - 1 for nodes in (22, 43)
    )
    np.testing.assert_array_less(np.abs(coarse), [1e-4, 4e-4, 1e-3])
    np.testing.assert_array_less(np.abs(fine), [1e-5, 3e-5, 1e-4])


@pytest.mark.parametrize("nodes", [8, 22, 40])
def test_nodes_have_the_mass_of_the_leg_and_one_is_at_the_anchor(nodes):
    rod = discretise(ROBOT.leg, nodes, ANCHOR)
    # Linear between the nodes, as the taper is: exact up to the arc length.
    assert rod.mass.sum() == pytest.approx(ROBOT.leg.mass, rel=1e-9)
    assert rod.arc[rod.anchor] / rod.arc[-1] == pytest.approx(ANCHOR, rel=1e-12)
    assert np.diff(rod.arc).max() / np.diff(rod.arc).min() < 1.5


HELD = 1e9  # kg, a torso that no leg moves
# m/s^2: the legs bend in both planes, twist and stretch
FIELD = np.array([-2.0, 4.0, -1.0])
SHARE, TIME, DAMPING = (0.7, 0.4), (0.05, 0.6), 0.01
RELAXING = config.replace(
    read_robot(),
    {
        "leg.young_modulus": 9e8,  # small deflections, above all vibrations
        "leg.relaxation_share": SHARE,
        "leg.relaxation_time": TIME,
        "leg.damping_time": DAMPING,
    },
)


def loaded(robot):
    """The robot above the floor, its torso held, its legs under a field from time 0 on."""
    held = dataclasses.replace(
        robot, torso=dataclasses.replace(robot.torso, mass=HELD)
    )
    start = {
        "start.height": 5.0,
        "start.settle": 0.0,
        "gravity": FIELD.tolist(),
        "solver.nodes": 10,
    }
    sim = RodRobot(
        held, config.replace(read_scene("flat"), start), read_servo()
    )
    sim.push(-HELD * FIELD, np.zeros(3))
    return sim


def creep(times):
    """Strain over its static value under a constant load, e = e_static f(t)."""

    def rate(_, y):
        e, a = y[0], y[1:]
        return [(1.0 - e - np.dot(SHARE, e - a)) / DAMPING, *((e - a) / TIME)]

    return solve_ivp(
        rate, (0.0, times[-1]), np.zeros(3), t_eval=times, rtol=1e-9, atol=1e-12
    ).y[0]


def test_a_loaded_leg_creeps_as_its_material_to_the_strain_of_youngs_modulus():
    sim = loaded(RELAXING)
    begin, times, course = (
        sim.state.node[0, -1].copy(),
        np.arange(1, 201) * 0.01,
        [],
    )
    for _ in times:
        sim.advance(10, np.zeros(4))
        course.append(sim.state.node[0, -1] - begin)
    plain = loaded(
        config.replace(RELAXING, {"leg.relaxation_share": (0.0, 0.0)})
    )
    # relaxing takes 1 s, and without it the motion decays in DAMPING
    sim.advance(10_000, np.zeros(4))
    plain.advance(2_000, np.zeros(4))
    static, expected = plain.state.node[0, -1] - begin, creep(times)
    np.testing.assert_allclose(sim.state.node[0, -1] - begin, static, rtol=1e-4)
    assert np.abs(static).min() > 1e-6
    assert expected[10] < 0.7
    shares = np.array(course) / static
    for axis in range(3):
        assert shares[1:, axis] == pytest.approx(expected[1:], abs=3e-3), axis


@pytest.mark.parametrize("legs", ["map", "paper"])
def test_only_spatial_legs_relax(legs):
    scene = config.replace(read_scene("flat"), {"solver.legs": legs})
    with pytest.raises(
        config.ConfigError,
        match=f"leg.relaxation_share = .* model '{legs}' cannot",
    ):
        make_robot(RELAXING, scene, read_servo())
