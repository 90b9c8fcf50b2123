"""Position PID on the host: terms, limits, anti-windup, missing readings."""

import dataclasses

import numpy as np
import pytest

from slot_core.dynamixel.driver import HostPid
from slot_core.dynamixel.settings import HostPidSettings

SETTINGS = HostPidSettings(
    p=2.0,
    i=0.0,
    d=0.0,
    filter_time=0.0,
    duty_limit=1.0,
    duty_rate=1e4,
    blind_time=0.03,
)
H = 0.01
FOUR = np.ones(4)


def pid(**changes):
    return HostPid(dataclasses.replace(SETTINGS, **changes))


def test_duty_is_p_times_the_error_minus_d_times_the_speed_also_when_the_goal_steps():
    loop = pid(d=0.1)
    for goal in (0.3, 0.5):
        duty = loop.step(goal * FOUR, 0.1 * FOUR, 2.0 * FOUR, H)
        assert duty == pytest.approx(2.0 * (goal - 0.1) - 0.1 * 2.0)


def test_the_integral_grows_with_error_and_time():
    loop = pid(p=0.0, i=3.0)
    for _ in range(10):
        duty = loop.step(0.2 * FOUR, 0 * FOUR, 0 * FOUR, H)
    assert duty == pytest.approx(3.0 * 0.2 * 10 * H)


def test_the_integral_is_held_while_the_duty_is_at_its_limit():
    loop = pid(p=1.0, i=5.0, duty_limit=0.5)
    for _ in range(500):
        assert np.all(loop.step(FOUR, 0 * FOUR, 0 * FOUR, H) <= 0.5)
    # The P term alone exceeds the limit, so the integral must not have grown.
    assert loop.integral == pytest.approx(0.0)
    assert np.all(loop.step(0.9 * FOUR, FOUR, 0 * FOUR, H) < 0.0)


def test_the_duty_changes_no_faster_than_its_rate():
    loop, before = pid(p=100.0, duty_rate=20.0), np.zeros(4)
    for goal in (1.0, 1.0, -1.0, -1.0, -1.0):
        duty = loop.step(goal * FOUR, 0 * FOUR, 0 * FOUR, H)
        assert np.all(np.abs(duty - before) <= 20.0 * H + 1e-12)
        before = duty


def test_without_a_reading_the_duty_is_held_for_blind_time_then_zero():
    loop = pid()
    angle = np.zeros(4)
    loop.step(0.2 * FOUR, angle, 0 * FOUR, H)
    angle[1] = np.nan
    duties = [loop.step(0.1 * FOUR, angle, 0 * FOUR, H) for _ in range(5)]
    assert [duty[1] for duty in duties] == pytest.approx(
        [0.4, 0.4, 0.4, 0.0, 0.0]
    )
    assert duties[-1][0] == pytest.approx(0.2)
    assert np.all(np.isfinite(duties))
