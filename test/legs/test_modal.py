"""Modal leg against closed forms, shooting of its differential equations, and the chain."""

import dataclasses
import re

import numpy as np
import pytest
from scipy.integrate import quad

from benchmarks.robot import modal_rows
from slot_core import config
from slot_core.dynamics.model import build_model
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.legs.leg_map import NoEquilibriumError, StaticLeg
from slot_core.legs.modal import ModalLeg
from slot_core.legs.modal_basis import Contact, Modes, tip_contact
from slot_core.robot import read_robot

ROBOT = read_robot()
LOAD = ROBOT.weight / 4
TIP = tip_contact(2e4)
# The nodes of a chain of 22 without its clamp.
SPREAD = Contact(tuple(np.arange(1, 22) / 21), (2e4,) * 21)
TWELVE, TWENTY, FINE = Modes((4, 4), (2, 2)), Modes((6, 6), (4, 4)), Modes((14, 14), (8, 8))


def straight(thickness_clamp, thickness_tip, length=0.2):
    """A straight leg, which the tests load without weight and with a slack tendon."""
    leg = dataclasses.replace(
        ROBOT.leg,
        reach=length,
        natural_shape=(0.0, 0.0, 0.0, 0.0),
        thickness_clamp=thickness_clamp,
        thickness_tip=thickness_tip,
        young_modulus=1e7,
    )
    return dataclasses.replace(ROBOT, leg=leg)


def stiffness(robot, thickness):
    return robot.leg.young_modulus * robot.leg.width * thickness**3 / 12


def test_end_moment_bends_a_uniform_leg_to_a_circle():
    robot = straight(1e-3, 1e-3)
    moment = -2 * np.pi * stiffness(robot, 1e-3) / robot.leg.reach  # downward: the tendon is slack
    shape = ModalLeg(robot, TIP, TWENTY).bend(moment=moment)
    angle = np.linspace(0.0, 2 * np.pi, len(shape))
    circle = robot.leg.reach / (2 * np.pi) * np.column_stack([np.sin(angle), np.cos(angle) - 1])
    # The modes represent the constant moment exactly; sixteen Gauss points in each part are exact
    # to 1e-13 of the length for a turn by 2/3 of a circle.
    np.testing.assert_allclose(shape, circle, atol=1e-11)


def test_small_load_bends_a_tapered_leg_as_in_beam_theory():
    robot, force = straight(0.0135, 0.0035), 1e-6
    length = robot.leg.reach

    def compliance(s):
        return (length - s) ** 2 / stiffness(robot, 0.0135 - 0.01 * s / length)

    deflection = force * quad(compliance, 0.0, length, epsabs=0.0, epsrel=1e-12)[0]
    tip = ModalLeg(robot, TIP).bend(force=(0.0, -force))[-1]
    # Beam theory neglects the square of the slope, 1e-10 here.
    assert -tip[1] == pytest.approx(deflection, rel=1e-8)


@pytest.mark.parametrize(
    ("load", "x", "z"),  # P L^2 / EI, tip over L: Bisshopp and Drucker's elliptic integrals
    [(1.0, 0.9435667637, 0.3017207738), (10.0, 0.4450044022, 0.8106090249)],
)
def test_thin_leg_is_the_elastica(load, x, z):
    robot = straight(1e-4, 1e-4)
    length = robot.leg.reach
    force = load * stiffness(robot, 1e-4) / length**2
    tip = ModalLeg(robot, TIP, Modes((9, 9), (6, 6))).bend(force=(0.0, -force))[-1]
    # It stretches by load h^2 / (12 L^2), up to 2e-7.
    np.testing.assert_allclose(tip / length, [x, -z], atol=3e-7)


@pytest.mark.parametrize(("modes", "limit"), [(TWELVE, 2e-5), (TWENTY, 1e-6), (FINE, 1e-9)])
def test_height_on_the_tip_converges_with_the_modes(modes, limit):
    angles = np.radians([0.0, 20.0, 40.0, 60.0, 80.0, 95.0, 105.0])
    exact = modal_rows.exact_heights(ROBOT, TIP, angles)
    leg = ModalLeg(ROBOT, TIP, modes)
    heights = [leg.stand(angle, LOAD).height for angle in angles]
    np.testing.assert_allclose(heights, exact, atol=limit)  # m; 0.02 mm at 12 unknowns


def test_force_at_a_held_height_converges_with_the_modes():
    fine, angles = ModalLeg(ROBOT, TIP, FINE), np.radians([54.0, 72.0, 90.0, 108.0])
    for height in (0.02, 0.05, 0.08):
        start = [modal_rows.guess(fine, fine.solve(a, height).force) for a in angles]
        exact = modal_rows.Exact(ROBOT, TIP).solve(angles, np.full(4, height), np.array(start))
        for modes, limit in ((TWELVE, 1e-4), (TWENTY, 1e-5)):
            leg = ModalLeg(ROBOT, TIP, modes)
            found = [leg.solve(angle, height) for angle in angles]
            # Error as a height, m, at the stiffness of each equilibrium; up to 12 N, more than when
            # standing.
            stiff = np.abs([here.stiffness for here in found])
            assert (np.abs([here.force for here in found] - exact) / stiff).max() < limit


def test_height_on_many_points_converges_to_the_exact_rod():
    contact, angles = SPREAD, np.radians([36.0, 60.0, 84.0])
    exact = modal_rows.exact_heights(ROBOT, contact, angles)
    errors = []
    for modes in (TWELVE, TWENTY, FINE):
        leg = ModalLeg(ROBOT, contact, modes)
        heights = [leg.stand(angle, LOAD).height for angle in angles]
        errors.append(np.abs(heights - exact).max())
    # The moment has kinks: algebraic convergence, from 0.2 mm to micrometres.
    assert errors[0] < 2e-4
    assert errors[1] < 4e-5
    assert errors[2] < 4e-6


def chain_force(nodes, angle, height, floor):
    leg = StaticLeg(ROBOT, nodes)
    changes = {"solver.nodes": nodes, "floor.contact": "tip", "floor.stiffness": floor}
    leg.model = build_model(ROBOT, config.replace(read_scene("flat"), changes), read_servo())
    for between in np.linspace(0.12, height, 20):
        leg.solve(0.0, between)
    for part in np.linspace(0.0, angle, 40):
        here = leg.solve(part, height)
    return here.force


@pytest.mark.parametrize(("angle_deg", "height"), [(50.0, 0.06), (70.0, 0.08), (108.0, 0.1)])
def test_chain_of_the_simulator_converges_to_the_modal_leg(angle_deg, height):
    angle, floor = np.radians(angle_deg), 2e5
    coarse, fine = (chain_force(nodes, angle, height, floor) for nodes in (121, 241))
    here = ModalLeg(ROBOT, tip_contact(floor), FINE).solve(angle, height)
    # Second order where the anchor is a node, as here: half the node distance leaves a quarter of
    # the error, 0.2 to 4 um, and Richardson's extrapolation a tenth of that or 0.1 um.
    left = abs(fine - here.force)
    assert abs(coarse - here.force) > 3.9 * left
    limit = max(0.1 * left, 1e-7 * -here.stiffness)
    assert fine + (fine - coarse) / 3 == pytest.approx(here.force, abs=limit)


def test_slope_and_stiffness_are_the_difference_quotients_of_the_force():
    leg, angle, height, step = ModalLeg(ROBOT, SPREAD), 1.2, 0.05, 1e-6
    here = leg.solve(angle, height)
    up, down = leg.solve(angle + step, height).force, leg.solve(angle - step, height).force
    assert here.slope == pytest.approx((up - down) / (2 * step), rel=1e-5)
    up, down = leg.solve(angle, height + step).force, leg.solve(angle, height - step).force
    assert here.stiffness == pytest.approx((up - down) / (2 * step), rel=1e-5)


def test_result_is_independent_of_earlier_solutions():
    leg, fresh = ModalLeg(ROBOT, SPREAD), ModalLeg(ROBOT, SPREAD)
    for degrees in np.linspace(0.0, 100.0, 201):
        leg.stand(np.radians(degrees), LOAD)
    leg.solve(1.0, 0.03)
    for degrees in (100.0, 40.0):
        height = fresh.stand(np.radians(degrees), LOAD).height
        # Newton's last increment is 1e-11 rad over 0.2 m.
        assert leg.stand(np.radians(degrees), LOAD).height == pytest.approx(height, abs=1e-11)


def test_free_and_held_clamp_give_the_same_equilibrium():
    leg = ModalLeg(ROBOT, TIP)
    standing = leg.stand(1.4, LOAD)
    held = leg.solve(1.4, standing.height)
    assert standing.leg.force == pytest.approx(LOAD, rel=1e-9)
    assert held.force == pytest.approx(LOAD, rel=1e-7)  # 1e-11 m at the floor's 2e4 N/m
    np.testing.assert_allclose(held.node, standing.leg.node, atol=1e-9)


def test_end_of_the_branch_is_an_error_with_the_last_angle():
    leg = ModalLeg(ROBOT, TIP)
    with pytest.raises(NoEquilibriumError, match=r"108\.000 deg: the branch ends") as raised:
        leg.stand(np.radians(108.0), LOAD)
    last = float(re.search(r"last equilibrium at ([\d.]+) deg", str(raised.value))[1])
    heights = np.linspace(0.1, 0.113, 14)  # it ends at 0.111 m
    just_below = [leg.solve(np.radians(last - 0.2), h).force for h in heights]
    beyond = [leg.solve(np.radians(last + 0.2), h).force for h in heights]
    # With the clamp held there are equilibria on both sides; beyond the end none carries the load.
    assert min(just_below) < LOAD
    assert min(beyond) > LOAD or max(beyond) < LOAD


@pytest.mark.parametrize(("angle", "height"), [(np.nan, 0.05), (1.0, np.nan)])
def test_nan_is_an_error_that_leaves_the_leg_usable(angle, height):
    leg = ModalLeg(ROBOT, TIP)
    before = leg.solve(1.0, 0.05).force
    with pytest.raises(NoEquilibriumError, match="the branch ends"):
        leg.solve(angle, height)
    assert leg.solve(1.0, 0.05).force == pytest.approx(before, rel=1e-9)


def test_a_leg_above_the_floor_hangs_under_its_weight_without_floor_force():
    leg = ModalLeg(ROBOT, TIP)
    here = leg.solve(0.0, 0.12)
    assert (here.force, here.slope, here.stiffness, here.tension) == (0.0, 0.0, 0.0, 0.0)
    # The weight is distributed in both models; 61 nodes are exact to some 1e-6 m.
    chain = StaticLeg(ROBOT, 61).solve(0.0, 0.12)
    np.testing.assert_allclose(here.node[-1], chain.node[-1], atol=5e-6)


def test_frequencies_match_the_known_ones():
    leg = ModalLeg(modal_rows.straight(ROBOT), TIP, TWENTY)
    # The known values are without stretch, which does not act on the bending of a straight leg.
    np.testing.assert_allclose(leg.frequencies()[:2], modal_rows.FREQUENCIES[:2], rtol=1e-7)
    np.testing.assert_allclose(leg.frequencies()[2], modal_rows.FREQUENCIES[2], rtol=2e-5)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Modes((0, 3), (1, 1)),
        lambda: Modes((3, 3), (1, -1)),
        lambda: Contact((), ()),
        lambda: Contact((0.0, 1.0), (1e4, 1e4)),
        lambda: Contact((1.0,), (1e4, 1e4)),
        lambda: tip_contact(float("nan")),
        lambda: ModalLeg(ROBOT, TIP).stand(1.0, 0.0),
    ],
)
def test_invalid_arguments_are_refused(make):
    with pytest.raises(ValueError, match=r"need|must"):
        make()
