"""Benchmark `world`: readings as the drivers of its sets deliver them, and its verdicts."""

import numpy as np
import pytest

from benchmarks.world import benchmark, drivers
from benchmarks.world.benchmark import verdict_of, worse_in
from benchmarks.world.field_loop import short
from benchmarks.world.sets import FAILS, REFUSED, STOPS, WALKS, WARNED
from slot_core.clock import LOCKSTEP_START, SECOND
from slot_core.geometry import quaternion_of_vector
from slot_core.safety.states import State
from slot_core.simulation.readings import ImuReading, OdometryReading

GOOD = {
    "gait": "walk",
    "moved": True,
    "ended": "WALKING",
    "holds": 0,
    "speed": 0.05,
    "aside": 4.0,
    "heading": 1.0,
    "tilt": 7.0,
    "height": 64.0,
}


def odometry(seconds, x):
    yaw = quaternion_of_vector(np.array([0.0, 0.0, np.pi / 2]))
    stamp = LOCKSTEP_START + round(seconds * SECOND)
    ahead = np.array([0.05, 0.0, 0.0])
    return OdometryReading(stamp, np.array([x, 1.0, 0.04]), yaw, ahead, ahead)


def test_a_slam_that_starts_in_a_walk_takes_its_place_and_heading_as_origin():
    memory = {}
    [before], [first], [later] = (
        drivers.started_slam(odometry(time, x), memory, begin=1.0)
        for time, x in ((0.9, 2.0), (1.0, 3.0), (2.0, 4.0))
    )
    assert before.position[0] == 2.0
    np.testing.assert_allclose(first.position, 0.0, atol=1e-12)
    np.testing.assert_allclose(later.position, [0.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(later.quaternion, [0, 0, 0, 1], atol=1e-12)


def test_an_imu_in_optical_axes_feels_gravity_upward_along_its_negative_y():
    felt = ImuReading(0, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 9.81]))
    [given] = drivers.other_imu(felt, {}, rpy_deg=(-90, 0, -90))
    np.testing.assert_allclose(given.specific_force, [0, -9.81, 0], atol=1e-12)
    np.testing.assert_allclose(given.angular_velocity, [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "named", "verdict"),
    [
        ({"speed": 0.046}, False, WALKS),
        ({"speed": 0.044}, False, FAILS),
        ({"speed": 0.044}, True, WARNED),
        ({"aside": 19.3}, True, WALKS),
        ({"aside": 19.5}, True, WARNED),
        ({"height": 67.0}, False, WALKS),
        ({"height": 67.1, "gait": "stand"}, False, FAILS),
        ({"holds": 1}, True, STOPS),
        ({"ended": "FAULT"}, False, FAILS),
        ({"moved": False, "ended": "READY"}, True, REFUSED),
        ({"moved": False, "ended": "READY"}, False, FAILS),
    ],
)
def test_a_row_walks_as_its_reference_or_a_line_names_the_cause(
    changes, named, verdict
):
    row = GOOD | changes
    assert verdict_of(row, bool(worse_in(row, GOOD)), named) == verdict


def test_states_passed_are_initials_with_their_repeats():
    hold, walk = State.HOLD, State.WALKING
    states = [State.READY, State.STANDING, walk, *[hold, walk] * 7, State.RELAX]
    assert short(states) == "RSW(HW)7X"


def test_an_interrupted_benchmark_keeps_its_runs_of_the_same_clean_revision(
    tmp_path, monkeypatch
):
    run, now = [], {"commit": "a", "dirty": False}

    def run_all(*names):
        jobs = [(name, "walk", 1, 8.0, "coarse") for name in names]
        return benchmark.run_all(jobs, tmp_path / "runs.jsonl", run.append)

    def in_processes(call, jobs, progress):
        progress([job[0] for job in jobs])
        return [(job, {"set": job[0]}) for job in jobs]

    monkeypatch.setattr(benchmark, "revision", lambda root: dict(now))
    monkeypatch.setattr(benchmark, "in_processes", in_processes)
    assert len(run_all("one")) == 1
    assert len(run_all("one", "two")) == 2
    now["dirty"] = True
    run_all("one")
    assert run == [["one"], ["two"], ["one"]]
