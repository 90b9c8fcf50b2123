"""The servo compared with its data sheet's torque-speed line and a first-order lag.

The tendon compared with the geometry of offset curves and the statics of a pulled rod.
"""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from numba import njit
from rod_robots import FLOATING, ROBOT, simulator
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from slot_core import config
from slot_core.dynamics.model import build_model
from slot_core.dynamics.rod import build, route
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo, servo, spool_rate, turning_rate
from slot_core.robot import read_robot
from slot_lab.leg_tests.leg_map import StaticLeg, tangent
from slot_lab.leg_tests.level_leg import level_leg

SETTINGS = config.replace(
    read_servo(),
    {
        "model": "torque_speed",
        "proportional": 4.6,
        "integral": 0.0,
        "derivative": 0.0,
    },
)
# ROBOTIS' e-manual of the XL430-W250: V, N m at stall, rev/min without load.
FIGURES = [(9.0, 1.0, 47.0), (11.1, 1.4, 57.0), (12.0, 1.5, 61.0)]
RPM = math.tau / 60.0  # rad/s
NOMINAL = 11.1  # V
STALL = 1.4 * SETTINGS.servo_per_tendon  # N m
NO_LOAD = 57.0 * RPM / SETTINGS.servo_per_tendon


@njit
def rate(law, command, angle, torque):
    return turning_rate(law, command, angle, torque)


@pytest.mark.parametrize(
    ("turn", "load", "share"),
    [(2.0, 0.5, 0.5), (2.0, 1.5, -0.5), (-2.0, 0.5, -1.5)],
)
def test_speed_follows_the_torque_speed_line_or_ignores_the_load(
    turn, load, share
):
    # A load beyond stall pulls the spool back; while releasing it adds speed.
    found = rate(servo(SETTINGS, NOMINAL), turn, 0.0, load * STALL)
    assert found == pytest.approx(share * NO_LOAD, abs=1e-12)
    law = servo(
        dataclasses.replace(SETTINGS, model="ideal", ideal_rpm=40.0), NOMINAL
    )
    found = rate(law, turn, 0.0, load * STALL)
    assert found == pytest.approx(np.sign(turn) * 40.0 / 57.0 * NO_LOAD)


def test_small_steps_are_a_first_order_lag():
    law, angle, step = servo(SETTINGS, NOMINAL), 0.0, 1e-4
    for _ in range(round(SETTINGS.lag / step)):
        angle += step * rate(law, 0.05, angle, 0.0)
    # Euler's method: (1 - h/tau)^(tau/h) = 1/e (1 - h / (2 tau)).
    assert angle == pytest.approx(0.05 * (1 - math.exp(-1)), rel=3e-3)


BETWEEN = [
    tuple(np.average(pair, axis=0, weights=(1, 3)))
    for pair in pairwise(FIGURES)
]


@pytest.mark.parametrize(
    ("voltage", "stall", "rpm"),
    [
        *FIGURES,
        *BETWEEN,
        (8.0, *FIGURES[0][1:]),  # measured beyond the maker's: the nearest
        (12.6, *FIGURES[2][1:]),
        (math.nan, *FIGURES[1][1:]),  # not measured: the nominal one
    ],
)
def test_stall_torque_and_speed_are_the_makers_at_its_voltages_and_linear_between(
    voltage, stall, rpm
):
    found, speed = SETTINGS.stall(voltage), SETTINGS.speed(voltage)
    assert (found, speed) == pytest.approx((stall, rpm * RPM), rel=1e-12)
    if voltage not in {8.0, 12.6} and not math.isnan(voltage):
        scene = config.replace(read_scene("flat"), {"supply_voltage": voltage})
        law = build_model(read_robot(), scene, SETTINGS).servo
        ratio = SETTINGS.servo_per_tendon
        wanted = rpm * RPM / ratio, 1.0 / (stall * ratio)
        assert (law.speed, law.speed_loss) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"voltage": [9.0, 12.0, 11.1]},
            r"voltage = \[9\.0, 12\.0, 11\.1\]: expected rising",
        ),
        ({"voltage": []}, r"voltage = \[\]: expected rising values"),
        (
            {"stall_torque": [1.0, 1.4]},
            r"stall_torque = \[1\.0, 1\.4\]: expected 3 values",
        ),
        (
            {"no_load_rpm": [47.0, 57.0, 0.0]},
            r"no_load_rpm\[2\] = 0\.0: outside \[1\.0, 1000\.0\]",
        ),
        (
            {"supply_voltage": 8.9},
            r"supply_voltage = 8\.9: outside \[9\.0, 12\.0\] V",
        ),
        (
            {"supply_voltage": math.nan},
            r"supply_voltage = nan: outside \[9\.0, 12\.0\] V",
        ),
    ],
)
def test_figures_that_are_no_table_and_voltages_beyond_it_are_refused(
    changes, message
):
    voltage = changes.pop("supply_voltage", NOMINAL)
    with pytest.raises(config.ConfigError, match=message):
        servo(config.replace(SETTINGS, changes), voltage)


@njit
def run(law, drive, angle, command, torque, h):  # noqa: PLR0917
    """Spool angle after each step of h; commands and torques (n,)."""
    out = np.zeros(len(command))
    for i in range(len(command)):
        angle += h * spool_rate(law, drive, command[i], angle, torque[i], h)
        out[i] = angle
    return out


PID = dataclasses.replace(
    SETTINGS, model="pid", integral=12.0, derivative=0.05, motor_time=0.02
)


def exact_response(settings, command, torque, seconds):
    """Angle after `seconds` by the equations of pid and motor, with a high-order integrator."""

    def derivative(_, y):
        angle, speed, integral = y
        error = command - angle
        duty = (
            settings.proportional * error
            + integral
            - settings.derivative * speed
        )
        bounded = min(1.0, max(-1.0, duty))
        rests = (duty - bounded) * error > 0.0
        target = NO_LOAD * (bounded - torque / STALL)
        growth = 0.0 if rests else settings.integral * error
        return [speed, (target - speed) / settings.motor_time, growth]

    options = {"rtol": 1e-9, "atol": 1e-12, "max_step": 1e-3}
    return solve_ivp(derivative, (0.0, seconds), [0.0] * 3, **options).y[0, -1]


@pytest.mark.parametrize(
    ("command", "torque"), [(0.05, 0.0), (0.05, 0.3), (1.5, 0.45)]
)
@pytest.mark.parametrize("seconds", [0.05, 0.15, 0.4])
def test_pid_follows_its_differential_equation_to_first_order(
    command, torque, seconds
):
    exact, errors = exact_response(PID, command, torque, seconds), []
    for h in (2e-4, 1e-4):
        steps = np.ones(round(seconds / h))
        law = servo(PID, NOMINAL)
        path = run(law, np.zeros(3), 0.0, command * steps, torque * steps, h)
        errors.append(abs(path[-1] - exact))
    # Euler's method: the error is below the motion of one step, at up to 6 rad/s, and halves too.
    assert errors[0] < 6.0 * 2e-4
    assert errors[1] < 0.6 * errors[0] + 1e-7


def test_the_guide_resists_the_spool_in_both_directions():
    """Euler's rope friction: the load counts 1.2 times while winding, 1 / 1.2 while releasing."""
    frictionless, h, load = servo(SETTINGS, NOMINAL), 1e-3, 0.5 * STALL
    law = frictionless._replace(friction=1.2)
    for command, seen in ((2.0, 1.2 * load), (0.0, load / 1.2)):
        path = run(
            law, np.zeros(3), 1.0, np.array([command]), np.array([load]), h
        )
        turned = h * rate(frictionless, command, 1.0, seen)
        assert path[0] - 1.0 == pytest.approx(turned, rel=1e-12)


@pytest.mark.parametrize("model", ["torque_speed", "pid"])
def test_a_servo_that_stalls_in_winding_holds_with_the_friction_of_its_guide(
    model,
):
    """Between stall / f and f stall the spool neither winds nor runs back."""
    law = servo(
        config.replace(SETTINGS, {"model": model, "proportional": 20.0}),
        NOMINAL,
    )
    law = law._replace(friction=1.2)
    for share, end in ((1.1, 1.0), (1.25, 0.0), (0.8, 2.0)):
        path = run(
            law,
            np.zeros(3),
            1.0,
            np.full(200, 2.0),
            np.full(200, share * STALL),
            1e-3,
        )
        assert np.sign(path[-1] - 1.0) == np.sign(end - 1.0)


def test_backlash_is_a_dead_band_between_motor_and_spool():
    """Slow motion without load: the spool follows the play operator, computed by hand."""
    play = math.radians(2.0)
    law = servo(
        dataclasses.replace(SETTINGS, model="ideal", backlash_deg=4.0), NOMINAL
    )
    h, drive, motor, spool, expected = 1e-3, np.zeros(3), 0.0, 0.0, []
    command = 0.3 * np.sin(np.linspace(0.0, 2 * math.tau, 4000))
    for target in command:
        # the encoder is on the spool
        motor += h * (target - spool) / SETTINGS.lag
        spool = min(max(spool, motor - play), motor + play)
        expected.append(spool)
    path = run(law, drive, 0.0, command, np.zeros(4000), h)
    np.testing.assert_allclose(path, expected, atol=1e-12)
    assert np.ptp(expected) > 0.3  # the motion exceeds the play


def test_a_taut_tendon_takes_up_the_backlash():
    law = servo(dataclasses.replace(SETTINGS, backlash_deg=4.0), NOMINAL)
    drive = np.zeros(3)
    path = run(
        law, drive, 0.5, np.full(3, 0.5), np.array([0.0, 0.2, 0.2]), 1e-3
    )
    # The tendon pulls it back by half the backlash at once; then it follows the motor.
    assert path[0] == pytest.approx(0.5, abs=1e-12)
    assert path[1] == pytest.approx(0.5 - math.radians(2.0), abs=1e-12)
    assert path[2] > path[1]
    assert drive[0] == pytest.approx(math.radians(2.0), abs=1e-12)


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
