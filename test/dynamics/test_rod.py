"""The soft leg compared with its energy, the elastica, beam theory and circular arcs."""

import dataclasses

import numpy as np
import pytest
from numba import njit
from planar_energy import leg_energy, mass_matrix
from scipy.integrate import solve_bvp
from scipy.linalg import eigh

from slot_core.dynamics.rod import build, discretise
from slot_core.dynamics.spatial.strain import measure, point_along
from slot_core.dynamics.tendon import route
from slot_core.robot import read_robot
from slot_lab.leg_tests.leg_map import relax
from slot_lab.leg_tests.level_leg import level_leg

ROBOT = read_robot()
ANCHOR = 2 / 3  # of the length
LENGTH = 0.19
SHORT = 1e-11  # s: within it a leg moves by its acceleration alone
HIGH = 1.0  # m, above the floor


@njit
def strain(s, rod, node, velocity, spin, rate):  # noqa: PLR0917
    point_along(s, node)
    clamp = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    measure(s, rod, velocity, spin, clamp, rate)


class WeightlessLeg:
    """An undamped leg without weight on a rod, its clamp held."""

    def __init__(self, rod):
        model, self.leg = level_leg(ROBOT, len(rod.node), {})
        tendon = route(rod, ROBOT.tendon)._replace(damping=0.0)
        self.rod = rod._replace(damping_time=0.0)
        self.model = model._replace(rod=self.rod, tendon=tendon, gravity=np.zeros(3))
        self.leg.field[3] = 0.0
        self.mass = mass_matrix(rod)

    def gradient(self, node, angle=0.0):
        """(N, 2) gradient of the energy by the nodes but the clamp: -M times the acceleration.

        angle: of the tendon, rad; zero: without a tendon.
        """
        leg = self.leg
        leg.stage[:, ::2], leg.spin[:] = node, 0.0
        leg.angle[0], leg.fault[1] = angle, angle > 0.0
        relax(self.model, leg, HIGH, SHORT, 0.0, 1)
        return -self.mass @ leg.velocity[:, ::2] / SHORT

    def strains(self, node, velocity, rate):
        """Segments with the strains at nodes (N, 2), m, and their rates, at a clamp's rate, rad/s."""
        place = np.insert(node, 1, 0.0, axis=1)
        along = np.diff(place, axis=0)
        spin = (
            along @ rate / np.linalg.norm(along, axis=1)
        )  # of segments that turn with the clamp
        strain(self.leg.segments, self.rod, place, velocity, spin, tuple(rate))
        return self.leg.segments


def straight(nodes, thickness=(5e-3, 5e-3)):
    """A straight rod of given thickness at clamp and tip, and the EI of the clamp's section."""
    leg = dataclasses.replace(
        ROBOT.leg,
        young_modulus=1e7,
        thickness_clamp=thickness[0],
        thickness_tip=thickness[1],
    )
    node = np.column_stack([np.linspace(0.0, LENGTH, nodes), np.zeros(nodes)])
    return build(
        leg, node, node[:, 0], round((nodes - 1) * ANCHOR)
    ), leg.young_modulus * leg.width * thickness[0] ** 3 / 12


def stiffness_matrix(leg, node, step=1e-7):
    """(2N-2, 2N-2) stiffness by central differences of the kernels' forces at the free nodes.

    A force depends on nodes at most two apart: every fifth node is shifted at once.
    """
    count = len(node)
    matrix = np.zeros((count, 2, count, 2))
    for first, axis in np.ndindex(5, 2):
        shift = np.zeros_like(node)
        shift[first::5, axis] = step
        change = leg.gradient(node + shift) - leg.gradient(node - shift)
        for moved in range(first, count, 5):
            near = slice(max(0, moved - 2), moved + 3)
            matrix[near, :, moved, axis] = change[near] / (2 * step)
    return matrix[1:, :, 1:].reshape(2 * count - 2, -1)


def bent(rod, load_at_tip):
    """(N, 2) equilibrium under a dead force (2,) at the tip: Newton's method in steps of load."""
    node, leg = rod.node.copy(), WeightlessLeg(rod)
    for part in np.linspace(0.0, 1.0, 21)[1:]:
        for _ in range(30):
            residual = leg.gradient(node)
            residual[-1] -= part * np.asarray(load_at_tip)
            change = np.linalg.solve(stiffness_matrix(leg, node), -residual[1:].ravel())
            node[1:] += change.reshape(-1, 2)
            if np.abs(change).max() < 1e-10:
                break
    assert np.abs(change).max() < 1e-10
    return node


def elastica(load_parameter, give=0.0):
    """Tip (x, y) / L of a cantilever under p = P L^2/(EI), by collocation.

    phi'' = -p (1 + e) cos(phi) and r' = (1 + e) (cos(phi), sin(phi)) with the stretch
    e = give p sin(phi), where give = EI / (EA L^2).
    """

    def slope(s, y):
        stretched = 1.0 + give * load_parameter * np.sin(y[0])
        turned = -load_parameter * stretched * np.cos(y[0])
        return np.array(
            [y[1], turned, stretched * np.cos(y[0]), stretched * np.sin(y[0])]
        )

    def ends(a, b):
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0.0, 1.0, 101)
    solution = solve_bvp(
        slope, ends, s, np.array([s, 1 - s, s, s**2 / 2]), tol=1e-10, max_nodes=9999
    )
    assert solution.success
    return solution.y[2:, -1]


def test_forces_are_the_gradient_of_the_energy():
    leg, angle = WeightlessLeg(discretise(ROBOT.leg, 10, ANCHOR)), 0.6
    node = leg.rod.node + np.random.default_rng(1).normal(scale=2e-3, size=(10, 2))
    node[0] = 0.0
    numeric, step = np.zeros_like(node), 1e-7
    for index in np.ndindex(node.shape):
        shift = np.zeros_like(node)
        shift[index] = step
        up, down = (
            leg_energy(leg.model, node + s * shift, angle, HIGH) for s in (1.0, -1.0)
        )
        numeric[index] = (up - down) / (2 * step)
    found = leg.gradient(node, angle)
    assert leg.leg.pull[0] > 30.0
    # Rounding of an energy of some 10 J: 1e-15 * 10 / 1e-7 = 1e-7 N; truncation stays below 1e-5.
    np.testing.assert_allclose(found[1:], numeric[1:], atol=1e-5)


def test_the_natural_shape_has_no_internal_force():
    leg = WeightlessLeg(discretise(ROBOT.leg, 22, ANCHOR))
    # Stiffest spring 6e5 N/m, positions rounded at 1e-17 m.
    assert np.abs(leg.gradient(leg.rod.node)[1:]).max() < 1e-9


def test_rigid_motion_dissipates_nothing():
    """Kelvin-Voigt damping depends on strain rates only; the clamp turns with the rod."""
    leg, rate = (
        WeightlessLeg(discretise(ROBOT.leg, 12, ANCHOR)),
        np.array([1.0, -3.0, 2.0]),
    )
    node = np.insert(leg.rod.node, 1, 0.0, axis=1)
    s = leg.strains(leg.rod.node, np.cross(rate, node), rate)
    assert np.abs(s.extension_rate).max() < 1e-15
    # differences of rates of 3 rad/s
    assert np.abs([s.twist_rate, s.turn_rate, s.side_rate]).max() < 1e-12


@pytest.mark.parametrize("load_parameter", [1.0, 10.0])
def test_cantilever_follows_the_elastica_to_third_order(load_parameter):
    exact = elastica(load_parameter, give=5e-3**2 / 12 / LENGTH**2)
    errors = []
    for nodes in (8, 31, 61):
        rod, stiffness = straight(nodes)
        tip = bent(rod, (0.0, load_parameter * stiffness / LENGTH**2))[-1]
        errors.append(np.hypot(*(tip / LENGTH - exact)))
    assert errors[0] < 3e-3  # of the length
    assert errors[1] < 2e-5
    assert errors[2] < 2e-6
    assert np.log(errors[0] / errors[2]) / np.log(60 / 7) > 3.0


def test_the_elastica_of_this_test_matches_the_published_values():
    # Bisshopp and Drucker's cantilever at P L^2/(EI) = 1, ten digits.
    np.testing.assert_allclose(elastica(1.0), [0.9435667637, 0.3017207738], atol=1e-8)


def rolled(nodes):
    """A rod under the end moment 2 pi EI / L, its shape computed hinge by hinge."""
    rod, stiffness = straight(nodes)
    moment = 2 * np.pi * stiffness / LENGTH
    bend = moment / rod.bending
    angle, length = np.cumsum(bend), rod.rest_length + rod.shortening * bend**2
    chord = length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return rod, moment, np.vstack([[0.0, 0.0], np.cumsum(chord, axis=0)])


@pytest.mark.parametrize("nodes", [8, 31])
def test_an_end_moment_bends_every_hinge_and_stretches_nothing(nodes):
    rod, moment, node = rolled(nodes)
    s = WeightlessLeg(rod).strains(node, np.zeros((nodes, 3)), np.zeros(3))
    np.testing.assert_allclose(
        rod.bending * (s.turn - rod.rest_angle), moment, rtol=1e-9
    )
    assert np.abs([s.twist, s.side]).max() == 0.0
    # Axial force from rounding: EA/l0 of 3e5 N/m times 1e-17 m.
    assert np.abs(rod.axial * s.extension).max() < 1e-9


def test_an_end_moment_closes_the_circle_to_third_order():
    gap = [np.hypot(*rolled(nodes)[2][-1]) / LENGTH for nodes in (31, 61, 121)]
    assert gap[0] < 3e-5
    assert np.log2(gap[0] / gap[2]) / 2 > 2.9


def lowest_frequencies(rod, count):
    """Lowest natural frequencies about the natural shape, Hz."""
    stiffness = stiffness_matrix(WeightlessLeg(rod), rod.node)
    mass = np.kron(mass_matrix(rod)[1:, 1:], np.eye(2))  # of the free nodes
    values = eigh((stiffness + stiffness.T) / 2, mass, eigvals_only=True)
    return np.sqrt(values[:count]) / (2 * np.pi)


def test_uniform_beam_vibrates_at_euler_bernoulli_frequencies():
    rod, stiffness = straight(41)
    per_length = rod.mass.sum() / LENGTH
    beta = (
        np.array([1.8751040687, 4.6940911330, 7.8547574382]) / LENGTH
    )  # clamped, free
    exact = beta**2 * np.sqrt(stiffness / per_length) / (2 * np.pi)
    # Fourth order in 1/40, growing with the mode; differences of forces limit the lowest one.
    np.testing.assert_array_less(
        np.abs(lowest_frequencies(rod, 3) / exact - 1), [2e-5, 1e-5, 5e-5]
    )


def test_tapered_leg_vibrates_at_the_frequencies_of_a_tapered_bernoulli_beam():
    taper = (ROBOT.leg.thickness_clamp, ROBOT.leg.thickness_tip)
    exact = np.array([6.5209720302, 25.5124367433, 61.3511026964])
    coarse, fine = (
        lowest_frequencies(straight(n, taper)[0], 3) / exact - 1 for n in (22, 43)
    )
    np.testing.assert_array_less(np.abs(coarse), [1e-4, 4e-4, 1e-3])
    np.testing.assert_array_less(np.abs(fine), [1e-5, 3e-5, 1e-4])


def test_the_nodes_have_the_mass_of_the_leg():
    rod = discretise(ROBOT.leg, 22, ANCHOR)
    # Linear between the nodes, as the taper is: exact up to the arc length.
    assert rod.mass.sum() == pytest.approx(ROBOT.leg.mass, rel=1e-9)
    assert np.all(np.diff(rod.mass[1:-1]) < 0)  # thinner towards the tip
