"""Clocks of the simulated robot: on answers, in real time, and waiting for a late driver."""

import pytest
import rod_robots

from slot_core import config
from slot_core.clock import LOCKSTEP_START, SECOND
from slot_core.dynamics.scene import read_scene
from slot_core.safety.settings import read_supervisor
from slot_core.safety.supervisor import PERIOD as SUPERVISOR
from slot_core.servos.servo_bus import JointReading
from slot_core.simulation.clocks import (
    PATIENCE,
    Answer,
    BusClock,
    LockstepClock,
    RealTimeClock,
)
from slot_core.simulation.readings import (
    ImuReading,
    OdometryReading,
    StampedHealth,
)
from slot_core.simulation.simulated_servos import DirectServos

SCENE = config.replace(read_scene("map"), {"start.settle": 0.1})
TICK = 0.033  # s
PERIOD = round(TICK * SECOND)  # ns
IMU = round(SCENE.sensors.imu.period * SECOND)  # ns
STEP = round(SCENE.solver.step * SECOND)  # ns
PORTION = 4 * STEP  # ns
NOW = 7 * SECOND  # ns


@pytest.fixture
def plant():
    return rod_robots.plant(SCENE)


@pytest.mark.parametrize("period", [0.033, 0.2])
def test_lockstep_advances_from_one_reading_to_the_next_on_its_answer_alone(
    period,
):
    """Whatever the period of the odometry."""
    scene = config.replace(SCENE, {"sensors.odometry.period": period})
    plant = rod_robots.plant(scene)
    servos = DirectServos(plant, lockstep=True)
    servos.watchdog.set_limits(read_supervisor().servo_limits)
    clock = LockstepClock(plant, servos, TICK)
    kinds = [type(reading) for reading in clock.at_rest()]
    assert kinds == [ImuReading, JointReading, OdometryReading]
    kind, stamp, answered = Answer.COMMAND, LOCKSTEP_START, []
    while len(answered) < 41:
        before, (other,) = plant.now, {*Answer} - {kind}
        for wrong in (stamp - PERIOD, stamp - 1, stamp + 1, stamp + PERIOD):
            assert list(clock.advance_on_answer(kind, wrong)) == []
        assert list(clock.advance_on_answer(other, stamp)) == []
        assert plant.now == before
        *_, reading = clock.advance_on_answer(kind, stamp)
        kind = Answer.COMMAND
        if isinstance(reading, StampedHealth):
            kind, stamp = Answer.STATE, reading.stamp
        else:
            assert isinstance(reading, ImuReading)
            stamp = LOCKSTEP_START + (len(found(answered, kind)) + 1) * PERIOD
            assert 0 <= reading.stamp - stamp < IMU
        answered.append((kind, stamp - LOCKSTEP_START))
    times = found(answered, Answer.COMMAND)
    # the first report of the servos is at rest
    _, *states = found(answered, Answer.STATE)
    period = round(SUPERVISOR * SECOND)
    assert states == [period * n for n in range(1, len(states) + 1)]
    assert min(len(times), len(states)) > 10


def found(answered, kind):
    """Times of the answers of a kind, ns after the start."""
    return [time for k, time in answered if k is kind]


def test_real_time_advances_by_at_most_one_portion(plant):
    clock, present = (
        RealTimeClock(plant, PORTION),
        NOW + 3 * PORTION + STEP // 2,
    )
    plant.start(NOW)
    for portions in (1, 2, 3, 3):  # in whole steps
        list(clock.advance_to(present))
        assert plant.now == NOW + portions * PORTION


class LateDriver:
    """A driver with a bus cycle every 10 ms of real time, and a robot whose clock follows it."""

    def __init__(self):
        self.plant = rod_robots.plant(SCENE, bus=True)
        self.now = NOW
        self.driver = self.plant.emulated.connect(lambda: self.now / SECOND)
        self.driver.configure()
        self.driver.activate()
        self.watchdog = round(self.driver.facts.watchdog * SECOND)  # ns
        self.clock = BusClock(self.plant, self.plant.emulated, PORTION)
        self.plant.start(NOW)

    def run(self, seconds, cycles=True):
        """Advance real time, with or without the bus cycles of the driver."""
        for _ in range(round(seconds * 500)):
            self.now += 2_000_000
            if cycles and self.now % 10_000_000 == 0:
                self.driver.cycle()
            list(self.clock.advance_to(self.now))

    def tripped(self):
        """Servos that their bus watchdog has stopped."""
        return sum(
            s.memory["bus_watchdog"] < 0 for s in self.plant.emulated.bus.servos
        )


@pytest.mark.parametrize("late", [0.15, 0.45])
def test_neither_a_late_driver_nor_a_late_simulation_trips_the_bus_watchdogs(
    late,
):
    driven = LateDriver()
    for _ in range(3):
        driven.run(0.5)
        assert driven.plant.now == driven.now  # it has caught up
        last = driven.now
        driven.run(late, cycles=False)
        assert driven.plant.now <= last + driven.watchdog
        assert driven.clock.waited > 0
    driven.run(0.5)
    assert driven.clock.waited == 0
    # the whole machine stands still; instructions are not yet read
    driven.now += SECOND
    driven.run(0.1, cycles=False)
    driven.run(1.2)
    assert driven.tripped() == 0
    assert driven.plant.now == driven.now


def test_an_ended_driver_trips_the_bus_watchdogs_on_the_robots_clock_as_soon_as_on_a_robot():
    driven = LateDriver()
    driven.run(0.1)
    last = driven.plant.now
    while not driven.tripped():
        driven.run(0.002, cycles=False)
    assert driven.plant.now - last <= driven.watchdog + PORTION
    assert driven.now - last <= PATIENCE + driven.watchdog + 10 * PORTION
    driven.run(1.0, cycles=False)
    assert driven.tripped() == 4
    assert driven.plant.now == driven.now
