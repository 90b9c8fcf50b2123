"""The tendon compared with the geometry of offset curves and the statics of a pulled rod."""

import numpy as np
import pytest
from rod_robots import FLOATING, ROBOT, simulator
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from slot_core.dynamics.rod import build, route
from slot_lab.leg_tests.leg_map import StaticLeg, tangent
from slot_lab.leg_tests.level_leg import level_leg


def tension(angle, rate):
    """Tension (N) of a leg in its natural shape at tendon angle (rad) and rate; its tendon."""
    model, leg = level_leg(ROBOT, 22, {})
    leg.angle[0], leg.rate[0] = angle, rate
    tangent(model, leg, 1.0)
    return leg.pull[0], model.tendon


@pytest.mark.parametrize("nodes", [10, 31])
def test_length_is_that_of_the_curve_at_the_offset(nodes):
    """On an arc of curvature k the curve at the offset d below has the length s (1 + k d)."""
    leg, settings, curvature = ROBOT.leg, ROBOT.tendon, -2.0
    fraction, length = np.linspace(0.0, 1.0, nodes), leg.arc_length()
    node = np.outer(length * fraction, [1.0, 0.0])
    rod = build(
        leg, node, node[:, 0], round((nodes - 1) * settings.end_fraction)
    )
    tendon = route(rod, settings)
    thick = (
        leg.thickness_clamp
        + (leg.thickness_tip - leg.thickness_clamp) * fraction
    )
    stiffness = leg.young_modulus * leg.width * thick[:-1] ** 3 / 12  # N m^2
    turn = curvature * stiffness / rod.bending  # bending of each hinge
    found = tendon.along @ rod.rest_length + tendon.around @ turn
    reach = settings.end_fraction * length
    assert found == pytest.approx(
        reach * (1.0 + curvature * settings.offset), rel=1e-12
    )


def test_a_slack_tendon_has_no_tension_and_a_taut_one_spring_and_damper():
    """In the natural shape the cable stretches by what the spool reels in beyond its slack."""
    radius, taut = (
        ROBOT.tendon.spool_radius,
        ROBOT.tendon.slack / ROBOT.tendon.spool_radius,
    )
    assert tension(0.99 * taut, 0.0)[0] == 0.0
    for rate in (0.0, 2.0):
        pull, tendon = tension(taut + 0.01, rate)
        damper = ROBOT.tendon.cable_damping * rate * radius
        assert pull == pytest.approx(
            tendon.stiffness * 0.01 * radius + damper, rel=1e-9
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
            leg.thickness_clamp
            + (leg.thickness_tip - leg.thickness_clamp) * s / length
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
    first, natural = (
        solve_ivp(derivative, (0, end), np.zeros(5), args=(pull,), **options).y[
            :, -1
        ]
        for pull in (force, 0.0)
    )
    tip = solve_ivp(derivative, (end, length), first, args=(0.0,), **options).y[
        1:3, -1
    ]
    return tip, first[3] + d * first[0] - natural[3] - d * natural[0]


def test_a_pulled_leg_converges_to_the_continuous_one_to_second_order():
    """Tension and shape of a free, weightless leg at a given tendon angle."""
    angle, settings = np.radians(80.0), ROBOT.tendon
    reeled = settings.spool_radius * angle - settings.slack
    force = brentq(
        lambda f: settings.cable_stiffness * (pulled_leg(f)[1] + reeled) - f,
        1.0,
        200.0,
    )
    exact, errors = pulled_leg(force)[0], []
    for nodes in (13, 22, 43):
        leg = StaticLeg(ROBOT, nodes)
        leg._leg.field[3] = 0.0  # gravity
        for part in np.linspace(0.1, 1.0, 10):
            here = leg.solve(part * angle, 1.0)
        errors.append(np.hypot(*(here.node[-1] - exact)))
    # N = 43, second order in 1/42
    assert here.tension == pytest.approx(force, rel=2e-3)
    assert (np.log(errors[0] / errors[2]) / np.log(42 / 12)) > 1.8
    assert errors[1] < 4e-4  # m at N = 22; without the anchor's own cell 5.7 mm


def test_slack_is_equivalent_to_an_angle_of_the_spool():
    """A tendon longer by s has at theta + s / r the tension of an intact one at theta."""
    found = []
    for slack in (0.0, 2e-3):
        angle = 1.0 + slack / ROBOT.tendon.spool_radius
        sim = simulator(**FLOATING, tendons__slack=[slack] * 4)
        sim.state.tendon_angle[:] = angle
        sim.advance(300, np.full(4, angle))
        found.append(np.concatenate([1e-2 * sim.tension, sim.nodes.ravel()]))
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)
