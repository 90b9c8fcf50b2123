"""Servos of the simulated robot: behind the watchdog, and on an emulated bus, without ROS."""

import dataclasses
import math
import os
import sys

import numpy as np
import pytest
import rod_robots

from slot_core import config
from slot_core.clock import SECOND
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import PWM_FULL, RAD_PER_COUNT, Mode
from slot_core.robot import LEGS, read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action
from slot_core.safety.watchdog import NO_LIMITS, Permission
from slot_core.servos.session import ServoSession
from slot_core.simulation.plant import ideal_servo
from slot_core.simulation.simulated_servos import (
    CLOSE_TIMEOUT,
    BusServos,
    DirectServos,
)
from slot_core.simulation.supervised_loop import SupervisedLoop

SCENE = config.replace(read_scene("map"), {"start.settle": 0.5})
LIMITS = read_supervisor().servo_limits
TICK = 10_000_000  # ns, a whole number of time steps
# A servo that reaches its goal under load; the bus's position loop stays 2 deg below it.
SERVO = config.replace(read_servo(), {"model": "torque_speed"})
COMMAND = np.array([1.3, 1.0, 0.9, 1.2])  # rad, within 0.3 rad of the start


@pytest.fixture
def direct():
    """Direct servos of a running robot, without limits."""
    servos = DirectServos(rod_robots.plant(SCENE, SERVO))
    servos._plant.start(SECOND)
    return servos


def act(servos, seconds, action, command=None):
    """The last health of servos stepped with their robot under a constant permission."""
    plant = servos._plant
    for _ in range(round(seconds * SECOND / TICK)):
        servos.permit(Permission(plant.now, action, False, "test"))
        if command is not None:
            servos.offer(plant.now, plant.now, command)
        servos.step(plant.now)
        health = servos.health(plant.now)
        list(plant.advance(plant.now + TICK))
    return health


def test_direct_servos_hold_without_limits_and_follow_commands_with_them(
    direct,
):
    robot = direct._plant.robot
    start = robot.tendon_angle
    with pytest.raises(ValueError, match=NO_LIMITS):
        direct.offer(SECOND, SECOND, COMMAND)
    health = act(direct, 0.2, Action.PASS)
    assert (health.action, health.reason) == (Action.HOLD, NO_LIMITS)
    assert health.torque.all()
    assert robot.tendon_angle == pytest.approx(start, abs=0.01)
    direct.watchdog.set_limits(LIMITS)
    health = act(direct, 1.0, Action.PASS, COMMAND)
    assert (health.action, health.reason) == (Action.PASS, "")
    assert (health.voltage == SCENE.supply_voltage).all()
    assert robot.tendon_angle == pytest.approx(COMMAND, abs=1e-3)


def test_tendons_unwind_without_torque_which_comes_back_at_the_angles_of_the_spools(
    direct,
):
    """A robot that is frozen before its first command is released by torque that goes off."""
    robot = direct._plant.robot
    direct.watchdog.set_limits(LIMITS)
    act(direct, 0.01, Action.OFF)
    assert not direct.released  # torque has never been permitted
    act(direct, 0.5, Action.PASS, COMMAND)
    assert not act(direct, 0.05, Action.OFF).torque.any()
    assert direct.released
    partly = robot.tendon_angle
    assert (partly > 0.1).all()
    assert (partly < COMMAND - 0.1).all()
    assert act(direct, 0.01, Action.HOLD).torque.all()
    assert not direct.released
    health = act(direct, 0.5, Action.PASS)  # the old command is not followed
    assert (health.action, health.reason) == (Action.HOLD, "no command yet")
    assert (health.goal == partly).all()
    assert robot.tendon_angle == pytest.approx(partly, abs=1e-3)
    act(direct, 1.0, Action.OFF)
    assert robot.tendon_angle == pytest.approx(np.zeros(4), abs=1e-3)
    assert robot.tension == pytest.approx(np.zeros(4), abs=1e-6)


@pytest.fixture
def bus(tmp_path):
    """Bus servos at a pseudo-terminal, with their simulated robot."""
    interval = sys.getswitchinterval()
    plant = rod_robots.plant(SCENE, bus=True)
    servos = BusServos(plant, link=tmp_path / "servos")
    yield servos, plant
    servos.close(running=False)
    sys.setswitchinterval(interval)


def set_torque(plant, *legs):
    """Torque on at the servos of `legs`, off at the others."""
    for leg, servo in zip(LEGS, plant.emulated.bus.servos):
        servo.memory["torque_enable"] = leg in legs


def test_bus_servos_are_powered_and_moved_by_their_driver_or_by_torque_taken_away(
    bus,
):
    """In real time; a command that only the driver has received counts."""
    servos, plant = bus
    memories = [servo.memory for servo in plant.emulated.bus.servos]

    def moving():
        servos.step(0)
        return servos.moving

    for legs in (("FL",), ("FL", "FR", "RL"), LEGS):
        set_torque(plant, *legs)
        assert servos.powered == (legs == LEGS)
    assert not moving()
    memories[2]["goal_position"] += 1
    assert moving()
    for memory in memories:
        memory["operating_mode"], memory["goal_pwm"] = Mode.PWM, 0
    assert not moving()
    memories[0]["goal_pwm"] = 1
    assert moving()
    memories[0]["goal_pwm"] = 0
    set_torque(plant, "FL", "FR", "RR")
    assert moving()


@pytest.mark.parametrize("running", [True, False])
def test_bus_servos_name_the_legs_left_under_torque_while_a_running_robot_advances(
    bus, tmp_path, running
):
    servos, plant = bus
    set_torque(plant, "FR", "RL")
    plant.start(0)
    assert (tmp_path / "servos").exists()
    assert servos.close(running=running) == "FR, RL"
    assert not (tmp_path / "servos").exists()
    assert (plant.now > 0) == running
    assert plant.now < CLOSE_TIMEOUT * SECOND


def test_bus_servos_replace_the_link_of_a_pseudo_terminal_but_no_file(
    bus, tmp_path
):
    file, link, ends = tmp_path / "file", tmp_path / "old", os.openpty()
    file.touch()
    with pytest.raises(config.ConfigError, match="file: exists already"):
        BusServos(bus[1], link=file)
    link.symlink_to(os.ttyname(ends[1]))
    servos = BusServos(bus[1], link=link)
    assert str(link.resolve()) != os.ttyname(ends[1])
    servos.close(running=False)
    for end in ends:
        os.close(end)


ROBOT = read_robot()
SETTLED = 150  # reports of the supervisor, 3 s: the robot walks at its speed


def make(scene="flat"):
    return rod_robots.plant(read_scene(scene), seed=1, bus=True)


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


def test_spools_turn_with_the_shafts_and_unwind_without_torque_to_the_gears_friction():
    plant = make()
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
        config.ConfigError,
        match=r"backlash_deg = 1\.0: emulated servos have none",
    ):
        ideal_servo(servo, 0.001)


@pytest.mark.parametrize("scene", ["flat", "low_battery"])
def test_servos_measure_the_scenes_voltage_and_the_torque_of_the_tendons(scene):
    plant = make(scene)
    driver = plant.emulated.connect(lambda: plant.now * 1e-9)
    session = ServoSession(driver, ROBOT.tendon.angle_max, 0.01, lambda _: None)
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
