"""Clocks of the simulated robot: lockstep advances on commands, real time in portions."""

import numpy as np
import pytest

from slot_core import config
from slot_core.clock import SECOND
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.clocks import LOCKSTEP_START, LockstepClock, RealTimeClock
from slot_core.simulation.plant import Plant
from slot_core.simulation.sensors import OdometryReading

SCENE = config.replace(read_scene("map"), {"start.settle": 0.1})
PERIOD = round(SCENE.sensors.odometry.period * SECOND)  # ns
DELAY = round(SCENE.sensors.odometry.delay * SECOND)  # ns
STEP = round(SCENE.solver.step * SECOND)  # ns
PORTION = 4 * STEP  # ns
NOW = 7 * SECOND  # ns


@pytest.fixture
def plant():
    return Plant(read_robot(), SCENE, read_servo(), np.random.default_rng(0))


@pytest.fixture
def lockstep(plant):
    """Lockstep clock, started."""
    clock = LockstepClock(plant)
    clock.start(NOW)
    return clock


@pytest.fixture
def real_time(plant):
    """Real-time clock, started at NOW."""
    clock = RealTimeClock(plant, PORTION)
    clock.start(NOW)
    return clock


def test_lockstep_starts_at_its_own_time(plant, lockstep):
    assert plant.now == lockstep.rest_stamp(NOW) == LOCKSTEP_START


def test_lockstep_advances_one_odometry_period_per_answered_reading(plant, lockstep):
    stamp = LOCKSTEP_START
    for tick in range(1, 6):
        odometry = [
            reading
            for reading in lockstep.advance_on_command(stamp)
            if isinstance(reading, OdometryReading)
        ]
        assert [reading.stamp for reading in odometry] == [LOCKSTEP_START + tick * PERIOD]
        stamp = odometry[0].stamp
        assert plant.now == stamp + DELAY  # when the reading is due


@pytest.mark.parametrize("offset", [-PERIOD, -1, 1, PERIOD])
def test_lockstep_does_not_advance_on_another_stamp(plant, lockstep, offset):
    stamp = list(lockstep.advance_on_command(LOCKSTEP_START))[-1].stamp
    before = plant.now
    assert list(lockstep.advance_on_command(stamp + offset)) == []
    assert plant.now == before


def test_lockstep_answers_a_stamp_once(plant, lockstep):
    list(lockstep.advance_on_command(LOCKSTEP_START))
    before = plant.now
    assert list(lockstep.advance_on_command(LOCKSTEP_START)) == []
    assert plant.now == before


def test_lockstep_does_not_advance_with_time(plant, lockstep):
    assert list(lockstep.advance_to(NOW + SECOND)) == []
    assert plant.now == LOCKSTEP_START


def test_real_time_starts_now(plant, real_time):
    assert plant.now == real_time.rest_stamp(NOW) == NOW
    assert real_time.lag(NOW) == 0


def test_real_time_does_not_advance_on_commands(plant, real_time):
    assert list(real_time.advance_on_command(NOW)) == []
    assert plant.now == NOW


def test_real_time_advances_to_the_present_in_whole_steps(plant, real_time):
    present = NOW + 5 * STEP // 2
    list(real_time.advance_to(present))
    assert plant.now == NOW + 2 * STEP
    assert real_time.lag(present) == STEP // 2


def test_real_time_advances_by_at_most_one_portion_and_reports_its_lag(plant, real_time):
    present = NOW + 3 * PORTION
    assert real_time.lag(present) == 3 * PORTION
    for portions in (1, 2, 3, 3):
        list(real_time.advance_to(present))
        assert plant.now == NOW + portions * PORTION
        assert real_time.lag(present) == (3 - portions) * PORTION


def test_real_time_yields_the_readings_of_the_portion(real_time):
    stamps = [
        reading.stamp
        for portion in range(1, 11)
        for reading in real_time.advance_to(NOW + portion * PORTION)
        if isinstance(reading, OdometryReading)
    ]
    last = NOW + 10 * PORTION - DELAY
    assert stamps == list(range(NOW + PERIOD, last + 1, PERIOD))
