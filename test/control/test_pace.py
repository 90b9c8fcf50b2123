"""Counters of late and skipped controller cycles; how fast time goes on."""

import math

import pytest

from slot_core.control.pace import Pace, Speed


def test_a_cycle_longer_than_its_period_is_an_overrun():
    pace = Pace()
    for elapsed in (0.01, 0.03, 0.031, 0.05):
        pace.add(1, elapsed, 0.03)
    assert pace.overruns == 2


@pytest.mark.parametrize(
    ("numbers", "skipped"), [((7, 8, 12, 13), 3), ((100, 1, 2, 5), 2)]
)
def test_inputs_between_two_processed_ones_are_skipped_also_after_a_restart(
    numbers, skipped
):
    pace = Pace()
    for number in numbers:
        pace.add(number, 0.0, 1.0)
    assert pace.skipped == skipped


def test_the_speed_is_that_of_the_last_second_also_if_nothing_is_reported_any_more():
    speed = Speed(1.0)
    for k in range(31):
        assert math.isnan(speed.until(k / 30 - 1e-9))
        speed.add(k / 30, 100.0 + k / 30)
    assert speed.until(1.0) == pytest.approx(1.0)
    for k in range(1, 31):
        speed.add(1.0 + k / 30, 101.0 + 0.6 * k / 30)
    assert speed.until(2.0) == pytest.approx(0.6)
    assert speed.until(2.5) == pytest.approx(0.3, abs=0.02)
    assert speed.until(9.0) == 0.0
