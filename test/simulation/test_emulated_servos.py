"""The simulated robot on emulated servos: shafts and spools, loads, a walk; without ROS."""

import dataclasses
import math

import numpy as np
import pytest
import rod_robots

from slot_core.config import ConfigError
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import PWM_FULL, RAD_PER_COUNT
from slot_core.robot import LEGS, read_robot
from slot_core.servos.session import ServoSession
from slot_core.simulation.plant import ideal_servo
from slot_core.simulation.supervised_loop import SupervisedLoop

ROBOT = read_robot()
SETTLED = 150  # reports of the supervisor, 3 s: the robot walks at its speed


def make(scene="flat"):
    return rod_robots.plant(read_scene(scene), seed=1, bus=True)


@pytest.fixture
def plant():
    return make()


def run(plant, duration):
    """Advance by a time (s) and return all readings."""
    return list(plant.advance(plant.now + round(duration * 1e9)))


def switch_on(plant, angles):
    """Write goals at tendon angles (4,), rad, and torque on to the registers."""
    for joint, servo, angle in zip(
        plant.emulated.joints, plant.emulated.bus.servos, angles
    ):
        servo.memory["goal_position"] = joint.counts(angle)
        servo.memory["torque_enable"] = 1


def test_spools_turn_with_the_shafts_and_unwind_without_torque_to_the_gears_friction(
    plant,
):
    robot, servos = plant.robot, plant.emulated
    before = robot.tendon_angle
    assert servos.angles() == pytest.approx(before, abs=1e-12)
    assert servos.powered() == ()
    plant.start(0)
    names = {type(reading).__name__ for reading in run(plant, 2.0)}
    assert "OdometryReading" in names
    assert "JointReading" not in names  # they come from the driver alone
    assert (robot.tendon_angle < before - 0.05).all()
    ratio = read_settings().joints.servo_per_tendon
    friction = read_emulator().servo.shaft.friction * ratio
    # the gear holds this load and creeps at a slightly larger one
    assert robot.servo_torque.max() < friction * 1.1
    switch_on(plant, robot.tendon_angle + np.array([0.3, -0.1, 0.2, 0.1]))
    assert servos.powered() == LEGS
    for _ in range(100):
        run(plant, 0.001)
        # rounding of angle + h (command - angle) / h
        assert robot.tendon_angle == pytest.approx(servos.angles(), abs=1e-12)
    low = -math.radians(read_settings().joints.margin_deg) / 2
    switch_on(plant, np.full(4, low))
    run(plant, 1.0)
    assert servos.angles().max() < 0.0
    assert (robot.tendon_angle >= 0.0).all()  # the range of the tendons


def test_backlash_is_refused():
    servo = dataclasses.replace(read_servo(), backlash_deg=1.0)
    with pytest.raises(
        ConfigError, match=r"backlash_deg = 1\.0: emulated servos have none"
    ):
        ideal_servo(servo, 0.001)


@pytest.mark.parametrize("scene", ["flat", "low_battery"])
def test_servos_measure_the_scenes_voltage_and_the_torque_of_the_tendons(scene):
    plant = make(scene)
    driver = plant.emulated.connect(lambda: plant.now * 1e-9)
    session = ServoSession(driver, ROBOT.tendon.angle_max, 0.01)
    driver.configure()
    driver.activate()
    plant.start(0)
    # every servo is asked for its voltage once in 16 cycles
    for _ in range(50):
        cycle = session.bus.cycle()
        run(plant, 0.01)
    assert session.voltage == pytest.approx(
        [read_scene(scene).supply_voltage] * 4, abs=1e-9
    )
    found = cycle.joints(plant.now, read_servo().tendon_stall(session.voltage))
    # within two counts of the encoder, of which the P gain makes 0.7 % of stall each, and what the
    # friction of the guide holds
    expected, give = plant.robot.servo_torque, ROBOT.tendon.capstan
    assert (
        np.abs(found.torque - expected)
        < 2 * 0.0071 * 1.45 + (give - 1) * expected
    ).all()


def test_the_simulated_servo_is_that_of_the_bus():
    """servo.yaml has the gains of the real servo's position control at the tendon angle.

    Its duty is P/128 of an error in counts, over the full duty; I and D act once a loop period.
    """
    settings, period, found = (
        read_settings(),
        read_emulator().servo.loop_period,
        read_servo(),
    )
    ratio, gains = settings.joints.servo_per_tendon, settings.gains
    # per rad of tendon angle, with gain 1
    duty = ratio / RAD_PER_COUNT / PWM_FULL
    assert found.model == "pid"
    assert found.servo_per_tendon == ratio
    assert found.proportional == pytest.approx(gains.p / 128 * duty, rel=1e-4)
    assert found.integral == pytest.approx(
        gains.i / 65536 * duty / period, rel=1e-4
    )
    assert found.derivative == pytest.approx(
        gains.d / 16 * duty * period, rel=1e-4
    )


def test_the_bus_changes_a_walk_by_millimetres_and_neither_overloads_nor_heats_a_servo():
    """The two differ by encoder, counts, bus cycles and driver alone; 10 s."""
    paths = []
    for hardware in ("sim", "fake_bus"):
        loop = SupervisedLoop("flat", "walk", None, 0, hardware=hardware)
        paths.append(
            np.array([loop.plant.robot.position for _ in loop.run(10.0)])
        )
    # 6.6 mm, 3 of other seeds; walks of two seeds differ by 4 to 7 mm
    assert np.sqrt(np.mean(np.sum((paths[1] - paths[0]) ** 2, axis=1))) < 8e-3
    distances = [path[-1, 0] - path[SETTLED, 0] for path in paths]
    assert distances[1] == pytest.approx(distances[0], abs=7e-3)  # 1 mm/s
    servos, room = (
        loop.plant.emulated.bus.servos,
        read_emulator().servo.shaft.room,
    )
    assert [servo.memory["hardware_error_status"] for servo in servos] == [
        0
    ] * 4
    assert max(servo.temperature() for servo in servos) < room + 5.0
    assert [health.error_rate for health in loop.servos.session.bus.health] == [
        0.0
    ] * 4
