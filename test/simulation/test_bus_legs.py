"""Emulated servos behind the driver: held goals, silence, and a walk against simulated servos."""

import numpy as np
import pytest

from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import PWM_FULL, RAD_PER_COUNT
from slot_core.emulator.emulated_bus import read_emulator
from slot_core.emulator.memory_port import MemoryPort
from slot_core.faults import Fault
from slot_core.robot import LEGS
from slot_core.simulation.bus_legs import EmulatedLegs
from slot_core.simulation.supervised_loop import SupervisedLoop

SETTLED = 150  # reports of the supervisor, 3 s: the robot walks at its speed


def walk(hardware):
    """A walk of 10 s: the loop at its end, and the torso's centre (n, 3), m, every 20 ms."""
    loop = SupervisedLoop("flat", "walk", None, 0, hardware=hardware)
    return loop, np.array([loop.plant.simulator.position for _ in loop.run(10.0)])


@pytest.fixture(scope="module")
def walks():
    return {hardware: walk(hardware) for hardware in ("sim", "fake_bus")}


def test_the_simulated_servo_is_that_of_the_bus():
    """servo.yaml has the gains of the real servo's position control at the tendon angle.

    Its duty is P/128 of an error in counts, over the full duty; I and D act once a loop period.
    """
    settings, period, found = read_settings(), read_emulator().servo.loop_period, read_servo()
    ratio, gains = settings.joints.servo_per_tendon, settings.gains
    duty = ratio / RAD_PER_COUNT / PWM_FULL  # per rad of tendon angle, with gain 1
    assert found.model == "pid"
    assert found.servo_per_tendon == ratio
    assert found.proportional == pytest.approx(gains.p / 128 * duty, rel=1e-4)
    assert found.integral == pytest.approx(gains.i / 65536 * duty / period, rel=1e-4)
    assert found.derivative == pytest.approx(gains.d / 16 * duty * period, rel=1e-4)


def test_the_bus_changes_the_walk_by_less_than_a_millimetre(walks):
    """The two differ by encoder, counts, bus cycles and driver alone."""
    (_, bus), (_, sim) = walks["fake_bus"], walks["sim"]
    # 0.32 to 0.33 mm with three seeds
    assert np.sqrt(np.mean(np.sum((bus - sim) ** 2, axis=1))) < 1e-3
    distances = [path[-1, 0] - path[SETTLED, 0] for path in (bus, sim)]
    assert distances[0] == pytest.approx(distances[1], abs=7e-3)  # 1 mm/s


def test_ten_seconds_of_walking_neither_overload_nor_heat_a_servo(walks):
    loop, _ = walks["fake_bus"]
    servos = loop.plant.legs.bus.servos
    assert [servo.memory["hardware_error_status"] for servo in servos] == [0] * 4
    assert max(servo.temperature() for servo in servos) < read_emulator().servo.shaft.room + 5.0
    assert [health.error_rate for health in loop.servos.session.driver.health] == [0.0] * 4


@pytest.mark.parametrize("load", [0.0, 0.3, 0.8])
def test_a_goal_is_held_with_the_droop_of_the_p_gain_under_load(load):
    legs, driver = driven()
    rest = []
    for _ in range(200):
        cycle(legs, driver, 1.5, load)
        rest.append(legs.angles())
    servo = read_servo()
    droop = load / servo.tendon_stall(legs.bus.servos[0].voltage) / servo.proportional
    # from 1 to 2 s, within one count of the encoder: no limit cycle
    assert rest[100:] == pytest.approx(np.full((100, 4), 1.5 - droop), abs=RAD_PER_COUNT)


def test_a_silent_servo_gives_no_reading_over_a_memory_port():
    legs, driver = driven()
    legs.bus.inject(Fault("silent", "RR", 0.0, 0.0, 0.0))
    found = driver.cycle()
    assert [reading is None for reading in found.readings] == [False, False, False, True]


def driven():
    """Servos at 0.5 rad and their driver, which runs on the servos' clock."""
    legs, settings = EmulatedLegs(read_settings(), read_emulator(), (0.5,) * 4), read_settings()

    def clock():
        return legs.bus.time

    driver = Driver(MemoryPort(legs.bus, settings.bus.baud, clock), settings, clock)
    assert len(driver.configure()) == len(LEGS)
    driver.activate()
    return legs, driver


def cycle(legs, driver, goal, load):
    """One bus cycle, then 10 ms under a load on every tendon (N m)."""
    driver.command([goal] * 4)
    driver.cycle()
    for _ in range(10):
        legs.advance(0.001, (load,) * 4)
