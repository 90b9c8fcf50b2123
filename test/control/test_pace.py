"""Counters of late and skipped controller cycles."""

from slot_core.control.pace import Pace


def test_a_cycle_longer_than_its_period_is_an_overrun():
    pace = Pace()
    for elapsed in (0.01, 0.03, 0.031, 0.05):
        pace.add(1, elapsed, 0.03)
    assert pace.overruns == 2


def test_inputs_between_two_processed_ones_are_skipped_and_those_before_the_first_are_not():
    pace = Pace()
    for number in (7, 8, 12, 13):
        pace.add(number, 0.0, 1.0)
    assert pace.skipped == 3


def test_a_restart_of_the_source_adds_no_skipped_inputs():
    pace = Pace()
    for number in (100, 1, 2, 5):
        pace.add(number, 0.0, 1.0)
    assert pace.skipped == 2
