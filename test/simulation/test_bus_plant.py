"""The simulated robot on emulated servos, without ROS."""

import dataclasses
import math

import numpy as np
import pytest

from slot_core.config import ConfigError
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.session import ServoSession, measured
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.emulator.emulated_bus import read_emulator
from slot_core.emulator.memory_port import MemoryPort
from slot_core.faults import Fault
from slot_core.robot import read_robot
from slot_core.simulation.bus_plant import BusPlant, immediate_servo

MS = 1_000_000  # ns
ROBOT = read_robot()


def make(scene="flat"):
    rng, settings, emulator = np.random.default_rng(1), read_settings(), read_emulator()
    return BusPlant(
        ROBOT, read_scene(scene), read_servo(), rng, settings=settings, emulator=emulator
    )


@pytest.fixture
def plant():
    return make()


def run(plant, duration):
    """Advance by a time (s) and return all readings."""
    return list(plant.advance(plant.now + round(duration * 1e9)))


def switch_on(plant, angles):
    """Write goals at tendon angles (4,), rad, and torque on to the registers."""
    for joint, servo, angle in zip(plant.legs.joints, plant.legs.bus.servos, angles):
        servo.memory["goal_position"] = joint.counts(angle)
        servo.memory["torque_enable"] = 1


def test_servos_start_at_the_settled_tendon_angles_with_torque_off(plant):
    assert plant.legs.angles() == pytest.approx(plant.simulator.tendon_angle, abs=1e-12)
    assert plant.powered() == ()


def test_spool_angles_equal_shaft_angles_after_every_step(plant):
    plant.start(0)
    switch_on(plant, plant.simulator.tendon_angle + np.array([0.3, -0.1, 0.2, 0.1]))
    assert plant.powered() == ("FL", "FR", "RL", "RR")
    for _ in range(100):
        run(plant, 0.001)
        # rounding of angle + h (command - angle) / h
        assert plant.simulator.tendon_angle == pytest.approx(plant.legs.angles(), abs=1e-12)


def test_loaded_servo_rests_where_its_duty_balances_the_tendon(plant):
    """P/128 (goal - position) / 885 = load / stall, the position in counts."""
    plant.start(0)
    settings, goal = read_settings(), np.full(4, 1.0)
    for servo in plant.legs.bus.servos:
        servo.memory["position_p_gain"] = settings.gains.p
    switch_on(plant, goal)
    run(plant, 2.0)
    ratio = settings.joints.servo_per_tendon
    load = plant.simulator.servo_torque / ratio
    assert load.min() > 0.1
    duty = settings.gains.p / 128 * (goal - plant.legs.angles()) * ratio / RAD_PER_COUNT / 885
    # one count of the encoder is 0.7 % of duty; the robot still moves a little
    stall = read_servo().stall(plant.simulator.scene.supply_voltage)
    give = ROBOT.tendon.capstan  # the friction of the guide holds part of the load
    assert (duty > load / stall / give - 0.015).all()
    assert (duty < load / stall * give + 0.015).all()


def test_without_torque_tendons_unwind_until_the_friction_of_the_gear_holds_them(plant):
    plant.start(0)
    before = plant.simulator.tendon_angle
    run(plant, 2.0)
    assert (plant.simulator.tendon_angle < before - 0.05).all()
    friction = read_emulator().servo.shaft.friction * read_settings().joints.servo_per_tendon
    # the gear holds this load and creeps at a slightly larger one
    assert plant.simulator.servo_torque.max() < friction * 1.1


def test_joint_readings_come_only_from_the_driver(plant):
    plant.start(0)
    names = {type(reading).__name__ for reading in run(plant, 0.1)}
    assert "OdometryReading" in names
    assert "JointReading" not in names


def test_command_not_sent_over_the_bus_has_no_effect():
    one, other = make(), make()
    for plant in (one, other):
        plant.start(0)
    one.command(np.full(4, 1.5))
    run(one, 0.1)
    run(other, 0.1)
    assert (one.simulator.tendon_angle == other.simulator.tendon_angle).all()


def test_backlash_is_refused():
    servo = dataclasses.replace(read_servo(), backlash_deg=1.0)
    with pytest.raises(ConfigError, match=r"backlash_deg = 1\.0: emulated servos have none"):
        immediate_servo(servo, 0.001)


def test_spool_angles_stay_within_the_range_of_the_tendons(plant):
    plant.start(0)
    low = -math.radians(read_settings().joints.margin_deg) / 2
    switch_on(plant, np.full(4, low))
    run(plant, 1.0)
    assert plant.legs.angles().max() < 0.0
    assert (plant.simulator.tendon_angle >= 0.0).all()


def driver_of(plant):
    """A driver on the plant's clock, with torque on."""
    settings = read_settings()

    def clock():
        return plant.now * 1e-9

    driver = Driver(MemoryPort(plant.legs.bus, settings.bus.baud, clock), settings, clock)
    driver.configure()
    driver.activate()
    return driver


@pytest.mark.parametrize("scene", ["flat", "low_battery"])
def test_servos_measure_the_scenes_voltage_and_the_torque_of_the_tendons(scene):
    plant = make(scene)
    session = ServoSession(driver_of(plant), ROBOT.tendon.angle_max, 0.01)
    plant.start(0)
    for _ in range(50):  # every servo is asked for its voltage once in 16 cycles
        cycle = session.driver.cycle()
        run(plant, 0.01)
    assert session.voltage == pytest.approx([read_scene(scene).supply_voltage] * 4, abs=1e-9)
    found = measured(plant.now, cycle, read_servo().tendon_stall(session.voltage))
    # within two counts of the encoder, of which the P gain makes 0.7 % of stall each, and what the
    # friction of the guide holds
    expected, give = plant.simulator.servo_torque, ROBOT.tendon.capstan
    assert (np.abs(found.torque - expected) < 2 * 0.0071 * 1.45 + (give - 1) * expected).all()


@pytest.mark.parametrize(
    ("kind", "value", "most"), [("tendon_broken", 0.0, 0.01), ("tendon_slack", 0.003, 0.4)]
)
def test_driver_measures_the_loss_of_load_of_a_damaged_tendon(plant, kind, value, most):
    """Measured: 0.47 of the stall torque at all servos, then 0 or 0.37 at this one."""
    driver = driver_of(plant)
    plant.start(0)

    def loads(cycles):
        for _ in range(cycles):
            cycle = driver.cycle()
            run(plant, 0.01)
        return np.array([reading.load for reading in cycle.readings])

    before = loads(50)
    plant.inject(Fault(kind, "RL", 0.0, 0.0, value))
    after = loads(50)
    count = 0.0071  # share of the stall torque that the P gain makes of one count of the encoder
    assert np.ptp(before) <= 2 * count
    assert np.argmin(after) == 2
    assert after[2] < most
    assert (
        after[[0, 3]].min() > before.min() + 2 * count
    )  # the torso tilts onto the neighbours of the leg
