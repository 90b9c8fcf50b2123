"""The tendon against the geometry of offset curves and the statics of a rod under its pull."""

import dataclasses

import numpy as np
import pytest
from numba import njit
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from slot_core.dynamics.leg_map import StaticLeg
from slot_core.dynamics.model import build_model
from slot_core.dynamics.rod import build, discretise, measure, segments
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.tendon import pull, route
from slot_core.robot import read_robot

ROBOT = read_robot()


@njit
def tension(s, tendon, node, angle, rate):
    measure(s, node, np.zeros((len(node), 3)), 0.0, 0.0)
    return pull(s, tendon, angle, rate, (0.0, 0.0), (0.0, 1.0))


def straight(nodes):
    length = ROBOT.leg.arc_length()
    node = np.column_stack([np.linspace(0.0, length, nodes), np.zeros(nodes)])
    return build(ROBOT.leg, node, node[:, 0], round((nodes - 1) * ROBOT.tendon.end_fraction))


@pytest.mark.parametrize("nodes", [10, 22, 31])
def test_length_is_that_of_the_curve_at_the_offset(nodes):
    """On an arc bent by curvature k the curve d below has the length s (1 + k d)."""
    rod, settings = straight(nodes), ROBOT.tendon
    tendon = route(rod, settings)
    curvature, bending = -2.0, section(rod)
    turn = curvature * bending / rod.bending  # every hinge bends by its share
    length = tendon.along @ rod.rest_length + tendon.around @ turn
    reach = settings.end_fraction * ROBOT.leg.arc_length()
    assert length == pytest.approx(reach * (1.0 + curvature * settings.offset), rel=1e-12)


def section(rod):
    """(N-1,) EI at nodes 0 .. N-2, N m^2."""
    leg, fraction = ROBOT.leg, rod.arc[:-1] / rod.arc[-1]
    thick = leg.thickness_clamp + (leg.thickness_tip - leg.thickness_clamp) * fraction
    return leg.young_modulus * leg.width * thick**3 / 12


@pytest.mark.parametrize("nodes", [8, 23, 40])
def test_any_number_of_nodes_puts_one_at_the_anchor(nodes):
    rod = discretise(ROBOT.leg, nodes, ROBOT.tendon.end_fraction)
    assert rod.arc[rod.anchor] / rod.arc[-1] == pytest.approx(ROBOT.tendon.end_fraction, rel=1e-12)
    assert np.diff(rod.arc).max() / np.diff(rod.arc).min() < 1.5


def test_a_slack_tendon_pulls_nothing():
    rod = discretise(ROBOT.leg, 22, ROBOT.tendon.end_fraction)
    tendon = route(rod, ROBOT.tendon)
    slack_ends = ROBOT.tendon.slack / ROBOT.tendon.spool_radius
    for angle in (0.0, 0.99 * slack_ends):
        assert tension(segments(22), tendon, rod.node, angle, 0.0) == 0.0
    pulled = tension(segments(22), tendon, rod.node, slack_ends + 0.01, 0.0)
    # 0.1 mm of stretch in the natural shape.
    assert pulled == pytest.approx(tendon.stiffness * 0.01 * ROBOT.tendon.spool_radius, rel=1e-9)


def test_damping_acts_on_the_rate_of_the_cable():
    rod = discretise(ROBOT.leg, 22, ROBOT.tendon.end_fraction)
    tendon = route(rod, ROBOT.tendon)
    taut = 0.4  # rad
    still = tension(segments(22), tendon, rod.node, taut, 0.0)
    turning = tension(segments(22), tendon, rod.node, taut, 2.0)
    expected = ROBOT.tendon.cable_damping * 2.0 * ROBOT.tendon.spool_radius
    assert turning - still == pytest.approx(expected, rel=1e-9)


def pulled_leg(force):
    """Tip (x, z) and tendon length of the continuous leg under a tension, without gravity.

    Between clamp and anchor the section carries the moment -T d and the axial force -T.
    """
    leg, end, d = ROBOT.leg, ROBOT.tendon.end_fraction * ROBOT.leg.arc_length(), ROBOT.tendon.offset
    length, slope = leg.arc_length(), leg.shape.deriv()
    curve = slope.deriv()

    def derivative(s, y, pulled):
        x = y[4]
        run = np.hypot(1.0, slope(x))
        thick = leg.thickness_clamp + (leg.thickness_tip - leg.thickness_clamp) * s / length
        bending = leg.young_modulus * leg.width * thick**3 / 12
        strain = -pulled / (leg.young_modulus * leg.width * thick)
        turning = curve(x) / run**3 - pulled * d / bending
        stretched = 1.0 + strain
        return [turning, stretched * np.cos(y[0]), stretched * np.sin(y[0]), stretched, 1.0 / run]

    options = {"rtol": 1e-10, "atol": 1e-12}
    first = solve_ivp(derivative, (0, end), np.zeros(5), args=(force,), **options).y[:, -1]
    natural = solve_ivp(derivative, (0, end), np.zeros(5), args=(0.0,), **options).y[:, -1]
    tip = solve_ivp(derivative, (end, length), first, args=(0.0,), **options).y[1:3, -1]
    return tip, first[3] + d * first[0] - natural[3] - d * natural[0]


def test_pulled_leg_converges_to_the_continuous_one_to_second_order():
    """Tension and shape of a hanging leg without weight, at a given angle of the spool."""
    angle, settings = np.radians(80.0), ROBOT.tendon
    reeled = settings.spool_radius * angle - settings.slack
    force = brentq(lambda f: settings.cable_stiffness * (pulled_leg(f)[1] + reeled) - f, 1.0, 200.0)
    exact, errors = pulled_leg(force)[0], []
    scene = dataclasses.replace(read_scene("flat"), gravity=(0.0, 0.0, 0.0))
    for nodes in (13, 22, 43):
        leg = StaticLeg(ROBOT, nodes)
        fine = dataclasses.replace(scene.solver, nodes=nodes)
        leg.model = build_model(ROBOT, dataclasses.replace(scene, solver=fine), read_servo())
        for part in np.linspace(0.1, 1.0, 10):
            here = leg.solve(part * angle, 1.0)
        errors.append(np.hypot(*(here.node[-1] - exact)))
    assert here.tension == pytest.approx(force, rel=2e-3)  # N = 43, second order in 1/42
    order = np.log(errors[0] / errors[2]) / np.log(42 / 12)
    assert order > 1.8
    assert errors[1] < 4e-4  # m at N = 22; without the anchor's own cell it is 5.7 mm
