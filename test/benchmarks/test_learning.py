"""Benchmark of the environment for learners: its rows and checks."""

import pytest

from benchmarks.learning.benchmark import GOAL_CASE, checks, throughput, walk_speeds

LEVEL, STEP = GOAL_CASE


def row(steps, threads=1, level=LEVEL, step=STEP):
    known = {"kind": "throughput", "level": level, "step": step, "threads": threads}
    return known | {"steps_per_s": steps, "speed": 0.033 * steps}


def test_the_goal_is_that_of_its_case_on_one_core():
    peer = {"kind": "peer", "name": "peer", "speed": 33.0}
    rows = [row(9e4, level="map"), row(9e4, threads=2), peer]
    cases = ((6000.0, True, True), (2000.0, False, True), (900.0, False, False))
    for steps, rate_holds, peer_holds in cases:
        found = checks([row(steps), *rows])
        assert [check.holds for check in found] == [rate_holds, peer_holds]


def test_throughput_counts_the_steps_of_every_robot():
    found = throughput("map", 0.0055, 1, 1)
    assert found["speed"] == pytest.approx(0.033 * found["steps_per_s"])
    assert found["steps_per_s"] > 100.0  # a hundredth of what it is


def test_the_gait_is_slower_on_tabulated_legs_where_the_floor_is_rough():
    smooth, rough = walk_speeds("map", 0.0055, (0.2, 0.6))
    assert 0.01 < rough < smooth < 0.05
