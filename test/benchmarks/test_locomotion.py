"""Benchmark of the locomotion: a controller that does nothing fails its checks."""

import dataclasses
import math

import numpy as np
import pytest

from benchmarks.locomotion import ablations, benchmark, transient_rows
from benchmarks.locomotion.cases import ALONE, COLUMNS, DEFAULT, Case, WalkMotion, payload, run_case
from benchmarks.locomotion.rows import LocomotionRow, rows, square
from slot_core import config
from slot_core.predictive.settings import read_predictive
from slot_core.simulation.closed_loop import ClosedLoop

SEEDS = dict.fromkeys(COLUMNS, (1,))


def still(case, column, seed):
    """Motion of a robot that stands level at 40 mm, whatever is commanded."""
    time = np.arange(0.0, case.duration, 0.033)
    position = np.tile([0.0, 0.0, 0.04], (len(time), 1))
    return WalkMotion(time, position, np.zeros((len(time), 3)), *np.zeros((2, len(time))), False)


def checks_of(wanted, move):
    jobs = [(c, column, 1) for row in wanted for c in row.cases for column in COLUMNS]
    motions = {job: move(*job) for job in jobs}
    return benchmark.checks(wanted, benchmark.measured(wanted, motions, SEEDS))


def test_a_controller_without_effect_fails_every_benefit():
    """Equal motions with and without it, here those of a robot that does not move."""
    wanted = rows(quick=False)
    checks = checks_of(wanted, still)
    found = [check for check in checks if check.name.endswith("over the gait alone")]
    assert len(found) > 20
    assert not [check.name for check in found if check.holds]


def test_a_controller_without_effect_fails_on_the_simulated_robot():
    """Payload of .5 kg: the default holds the height better; the gait alone does not."""
    case = Case(4.0, gait="stand", pose=(0.03, 0.0, 0.0), changes=payload(0.5, (0.06, 0.04, 0.02)))
    (like,) = [r for r in rows(quick=True) if r.name == "standing, payload .5 kg: height"]
    wanted = [dataclasses.replace(like, cases=[case])]
    moved = {column: run_case(case, column, 1) for column in (ALONE, DEFAULT)}

    def default(c, column, s):
        return moved.get(column, moved[ALONE])

    assert checks_of(wanted, default)[1].holds
    assert [check.holds for check in checks_of(wanted, lambda *_: moved[ALONE])] == [False, False]


def test_the_gait_alone_commands_the_angles_of_the_gait():
    """Under a payload, of which nothing else takes account."""
    changes = {"scene.payload.mass": 0.5}
    for gait, velocity in (("stand", 0.0), ("walk", 0.05)):
        speed = np.array([velocity, 0.0, 0.0])
        loop = ClosedLoop("flat", gait, speed, 1, COLUMNS[ALONE], changes=changes)
        for tick in loop.run(30):
            assert tick.command.angle == pytest.approx(tick.preview.tendon_angle[0], abs=1e-9)


def test_a_fall_is_worse_than_any_error():
    case = Case(4.0)
    fallen = dataclasses.replace(still(case, DEFAULT, 1), fallen=True)
    small = LocomotionRow("a", "mm", 1.0, [case], lambda cases, motions: 0.0)
    large = dataclasses.replace(small, larger=True)
    assert small.value([fallen]) == math.inf
    assert large.value([fallen]) == 0.0


def test_the_commanded_square_closes():
    """The motion that integrates its schedule, in steps of 1 ms: off by less than 2 mm."""
    case, dt = square(), 1e-3
    times = np.arange(0.0, case.duration, dt)
    begins = [begin for begin, _ in case.schedule]
    velocity = np.array([v for _, v in case.schedule])
    velocity = velocity[np.searchsorted(begins, times, side="right") - 1]
    yaw = np.cumsum(velocity[:, 2]) * dt
    x, y = np.cumsum(velocity[:, 0] * [np.cos(yaw), np.sin(yaw)], axis=1) * dt
    rpy = np.column_stack([np.zeros((len(times), 2)), yaw])
    motion = WalkMotion(times, np.column_stack([x, y, 0 * times]), rpy, 0 * times, 0 * times, False)
    found = {row.name: row.value([motion]) for row in rows(quick=False) if "square" in row.name}
    assert found["square of .6 m closes"] < 2.0
    assert found["square of .6 m, heading"] < 0.2


def test_a_part_that_changes_nothing_fails_its_check():
    wanted = [*rows(quick=False), *transient_rows.rows(quick=False)]
    jobs = ablations.jobs(wanted)
    motions = {job: still(*job) for job in jobs}
    for changes in ablations.ABLATIONS.values():
        mine = {name.partition(".")[2]: value for name, value in changes}
        assert config.replace(read_predictive(), mine, "policy") is not None
    found = ablations.checks(ablations.measured(wanted, motions))
    assert len(found) == len(ablations.ABLATIONS) - 1
    assert not [check.name for check in found if check.holds]
