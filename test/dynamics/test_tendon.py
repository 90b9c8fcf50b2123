"""The tendon compared with the geometry of offset curves and the statics of a pulled rod."""

import numpy as np
import pytest
from rod_robots import FLOATING, ROBOT, simulator
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from slot_core.dynamics.rod import build, discretise
from slot_core.dynamics.tendon import route
from slot_lab.leg_tests.leg_map import StaticLeg
from slot_lab.leg_tests.level_leg import level_leg
from slot_lab.leg_tests.sticking_leg import tangent


def tension(angle, rate):
    """Tension (N) of a leg in its natural shape at tendon angle (rad) and rate; its tendon."""
    model, leg = level_leg(ROBOT, 22, {})
    leg.angle[0], leg.rate[0] = angle, rate
    tangent(model, leg, 1.0)
    return leg.pull[0], model.tendon


def straight(nodes):
    length = ROBOT.leg.arc_length()
    node = np.column_stack([np.linspace(0.0, length, nodes), np.zeros(nodes)])
    return build(
        ROBOT.leg, node, node[:, 0], round((nodes - 1) * ROBOT.tendon.end_fraction)
    )


@pytest.mark.parametrize("nodes", [10, 22, 31])
def test_length_is_that_of_the_curve_at_the_offset(nodes):
    """On an arc of curvature k the curve at the offset d below has the length s (1 + k d)."""
    rod, settings = straight(nodes), ROBOT.tendon
    tendon = route(rod, settings)
    curvature, bending = -2.0, section(rod)
    turn = curvature * bending / rod.bending  # bending of each hinge
    length = tendon.along @ rod.rest_length + tendon.around @ turn
    reach = settings.end_fraction * ROBOT.leg.arc_length()
    assert length == pytest.approx(
        reach * (1.0 + curvature * settings.offset), rel=1e-12
    )


def section(rod):
    """(N-1,) EI at nodes 0 .. N-2, N m^2."""
    leg, fraction = ROBOT.leg, rod.arc[:-1] / rod.arc[-1]
    thick = leg.thickness_clamp + (leg.thickness_tip - leg.thickness_clamp) * fraction
    return leg.young_modulus * leg.width * thick**3 / 12


@pytest.mark.parametrize("nodes", [8, 23, 40])
def test_a_node_is_at_the_anchor_for_any_number_of_nodes(nodes):
    rod = discretise(ROBOT.leg, nodes, ROBOT.tendon.end_fraction)
    assert rod.arc[rod.anchor] / rod.arc[-1] == pytest.approx(
        ROBOT.tendon.end_fraction, rel=1e-12
    )
    assert np.diff(rod.arc).max() / np.diff(rod.arc).min() < 1.5


def test_a_slack_tendon_has_no_tension():
    slack_ends = ROBOT.tendon.slack / ROBOT.tendon.spool_radius
    for angle in (0.0, 0.99 * slack_ends):
        assert tension(angle, 0.0)[0] == 0.0
    pulled, tendon = tension(slack_ends + 0.01, 0.0)
    # 0.1 mm of stretch in the natural shape.
    assert pulled == pytest.approx(
        tendon.stiffness * 0.01 * ROBOT.tendon.spool_radius, rel=1e-9
    )


def test_damping_acts_on_the_rate_of_the_cable():
    taut = 0.4  # rad
    expected = ROBOT.tendon.cable_damping * 2.0 * ROBOT.tendon.spool_radius
    assert tension(taut, 2.0)[0] - tension(taut, 0.0)[0] == pytest.approx(
        expected, rel=1e-9
    )


def pulled_leg(force):
    """Tip (x, z) and tendon length of the continuous leg under a tension, without gravity.

    Between clamp and anchor the section carries the moment -T d and the axial force -T.
    """
    leg, end, d = (
        ROBOT.leg,
        ROBOT.tendon.end_fraction * ROBOT.leg.arc_length(),
        ROBOT.tendon.offset,
    )
    length, slope = leg.arc_length(), leg.shape.deriv()
    curve = slope.deriv()

    def derivative(s, y, pulled):
        x = y[4]
        run = np.hypot(1.0, slope(x))
        thick = (
            leg.thickness_clamp + (leg.thickness_tip - leg.thickness_clamp) * s / length
        )
        bending = leg.young_modulus * leg.width * thick**3 / 12
        strain = -pulled / (leg.young_modulus * leg.width * thick)
        turning = curve(x) / run**3 - pulled * d / bending
        stretched = 1.0 + strain
        return [
            turning,
            stretched * np.cos(y[0]),
            stretched * np.sin(y[0]),
            stretched,
            1.0 / run,
        ]

    options = {"rtol": 1e-10, "atol": 1e-12}
    first = solve_ivp(derivative, (0, end), np.zeros(5), args=(force,), **options).y[
        :, -1
    ]
    natural = solve_ivp(derivative, (0, end), np.zeros(5), args=(0.0,), **options).y[
        :, -1
    ]
    tip = solve_ivp(derivative, (end, length), first, args=(0.0,), **options).y[1:3, -1]
    return tip, first[3] + d * first[0] - natural[3] - d * natural[0]


def test_a_pulled_leg_converges_to_the_continuous_one_to_second_order():
    """Tension and shape of a free, weightless leg at a given tendon angle."""
    angle, settings = np.radians(80.0), ROBOT.tendon
    reeled = settings.spool_radius * angle - settings.slack
    force = brentq(
        lambda f: settings.cable_stiffness * (pulled_leg(f)[1] + reeled) - f, 1.0, 200.0
    )
    exact, errors = pulled_leg(force)[0], []
    for nodes in (13, 22, 43):
        leg = StaticLeg(ROBOT, nodes)
        leg._leg.field[3] = 0.0  # gravity
        for part in np.linspace(0.1, 1.0, 10):
            here = leg.solve(part * angle, 1.0)
        errors.append(np.hypot(*(here.node[-1] - exact)))
    assert here.tension == pytest.approx(
        force, rel=2e-3
    )  # N = 43, second order in 1/42
    order = np.log(errors[0] / errors[2]) / np.log(42 / 12)
    assert order > 1.8
    assert errors[1] < 4e-4  # m at N = 22; without the anchor's own cell 5.7 mm


def test_only_the_broken_tendon_has_no_tension():
    whole, broken = (
        simulator(**FLOATING),
        simulator(**FLOATING, tendons__broken=[False, True, False, False]),
    )
    for sim in (whole, broken):
        sim.advance(500, np.full(4, 1.5))
    assert broken.tension[1] == 0.0
    np.testing.assert_allclose(broken.tension[[0, 2, 3]], whole.tension[0], rtol=0.02)
    # Its leg keeps its natural shape, except for the effect of the torso's rotation.
    here, natural = broken.state.node[1, :, ::2], broken.model.rod.node
    assert np.abs(here - natural).max() < 1e-3
    assert np.abs(whole.state.node[1, :, ::2] - natural).max() > 0.03


def test_slack_is_equivalent_to_an_angle_of_the_spool():
    """A tendon longer by s has at theta + s / r the tension of an intact one at theta."""
    slack = 2e-3
    angle = slack / ROBOT.tendon.spool_radius
    whole, slackened = (
        simulator(**FLOATING),
        simulator(**FLOATING, tendons__slack=[slack] * 4),
    )
    whole.state.tendon_angle[:] = 1.0
    slackened.state.tendon_angle[:] = 1.0 + angle
    whole.advance(300, np.full(4, 1.0))
    slackened.advance(300, np.full(4, 1.0 + angle))
    np.testing.assert_allclose(slackened.tension, whole.tension, rtol=1e-9)
    np.testing.assert_allclose(slackened.nodes, whole.nodes, atol=1e-9)
