"""Falls, spins and sudden pulls: finite, no energy gain, no sinking, same result at h/2."""

import dataclasses

import pytest

from benchmarks.robot.hard_cases import FULL_DEG, IMPACTS, PULLS
from benchmarks.robot.stress import examine
from slot_core.robot import read_robot


@pytest.mark.parametrize("name", IMPACTS)
def test_a_fall_stays_within_its_limits(name):
    record = examine(IMPACTS[name])
    assert record.holds(IMPACTS[name].limits), record


@pytest.mark.parametrize("name", PULLS)
def test_a_sudden_pull_stays_within_its_limits(name):
    record = examine(PULLS[name])
    assert record.holds(PULLS[name].limits), record
    assert not record.unconverged


def test_the_full_pull_is_the_largest_tendon_angle_of_the_robot():
    assert read_robot().tendon.angle_max_deg == FULL_DEG


def test_a_full_pull_within_one_step_diverges_without_halving():
    case = PULLS["full pull within one step, in the air"]
    whole = dataclasses.replace(case, scene={**case.scene, "solver.halvings": 0})
    assert examine(case).halvings > 0
    assert "beyond 100.0 m/s" in examine(whole).lost
