"""The servo against its data sheet's line and the response of a first-order lag."""

import dataclasses
import math

import numpy as np
import pytest
from numba import njit

from slot_core import config
from slot_core.config import ConfigError
from slot_core.dynamics.servo import ServoSettings, read_servo, servo, turning_rate

SETTINGS = read_servo()
NO_LOAD = 57.0 * math.tau / 60.0


@njit
def rate(law, command, angle, torque):
    return turning_rate(law, command, angle, torque)


@pytest.mark.parametrize(("torque", "share"), [(0.0, 1.0), (0.7, 0.5), (1.4, 0.0), (2.1, -0.5)])
def test_pulling_speed_follows_the_torque_speed_line(torque, share):
    # XL430-W250 at 11.1 V: 57 rpm without load, 1.4 N m at rest; beyond that it is pulled back.
    assert rate(servo(SETTINGS), 2.0, 0.0, torque) == pytest.approx(share * NO_LOAD, abs=1e-12)


def test_load_helps_when_releasing():
    assert rate(servo(SETTINGS), 0.0, 2.0, 0.7) == pytest.approx(-1.5 * NO_LOAD, rel=1e-12)


def test_power_is_that_of_a_motor():
    """Torque times speed is at most a quarter of stall torque times no-load speed."""
    torque = np.linspace(0.0, 1.4, 101)
    power = max(t * rate(servo(SETTINGS), 2.0, 0.0, t) for t in torque)
    assert power == pytest.approx(1.4 * NO_LOAD / 4, rel=1e-3)  # grid of torques
    assert power < 2.1  # W


def test_small_steps_are_a_first_order_lag():
    law, angle, step = servo(SETTINGS), 0.0, 1e-4
    for _ in range(round(SETTINGS.lag / step)):
        angle += step * rate(law, 0.05, angle, 0.0)
    # Euler's method: (1 - h/tau)^(tau/h) = 1/e (1 - h / (2 tau)).
    assert angle == pytest.approx(0.05 * (1 - math.exp(-1)), rel=3e-3)


def test_ideal_servo_ignores_the_load():
    law = servo(dataclasses.replace(SETTINGS, model="ideal", ideal_rpm=40.0))
    for torque in (0.0, 1.4, 5.0):
        assert rate(law, 2.0, 0.0, torque) == pytest.approx(40.0 * math.tau / 60.0)
        assert rate(law, 0.0, 2.0, torque) == pytest.approx(-40.0 * math.tau / 60.0)


def test_unknown_model_is_refused_by_name():
    with pytest.raises(ConfigError, match="magic"):
        config.build(ServoSettings, dataclasses.asdict(SETTINGS) | {"model": "magic"}, "test")
