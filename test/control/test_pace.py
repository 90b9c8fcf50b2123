"""Counters of late and skipped controller cycles; how fast time goes on."""

import math

import pytest

from slot_core.control.pace import Pace, Speed


@pytest.mark.parametrize(
    ("numbers", "skipped"), [((7, 8, 12, 13), 3), ((100, 1, 2, 5), 2)]
)
def test_long_cycles_and_skipped_inputs_are_counted_also_after_a_restart(
    numbers, skipped
):
    pace = Pace()
    for number, elapsed in zip(numbers, (0.01, 0.03, 0.031, 0.05)):
        pace.add(number, elapsed, 0.03)
    assert (pace.overruns, pace.skipped) == (2, skipped)


def test_the_speed_is_that_of_the_last_second_also_if_nothing_is_reported_any_more():
    speed = Speed(1.0)
    for k in range(61):
        assert math.isnan(speed.until(k / 30 - 1e-9)) == (k <= 30)
        speed.add(k / 30, 100.0 + (k if k <= 30 else 30 + 0.6 * (k - 30)) / 30)
    for now, expected in ((2.0, 0.6), (2.5, 0.3), (9.0, 0.0)):
        assert speed.until(now) == pytest.approx(expected, abs=0.02)
