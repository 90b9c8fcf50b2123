"""Counters of late and skipped controller cycles."""

import pytest

from slot_core.control.pace import Pace


def test_a_cycle_longer_than_its_period_is_an_overrun():
    pace = Pace()
    for elapsed in (0.01, 0.03, 0.031, 0.05):
        pace.add(1, elapsed, 0.03)
    assert pace.overruns == 2


@pytest.mark.parametrize(("numbers", "skipped"), [((7, 8, 12, 13), 3), ((100, 1, 2, 5), 2)])
def test_inputs_between_two_processed_ones_are_skipped_also_after_a_restart(numbers, skipped):
    pace = Pace()
    for number in numbers:
        pace.add(number, 0.0, 1.0)
    assert pace.skipped == skipped
