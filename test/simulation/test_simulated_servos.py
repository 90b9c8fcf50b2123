"""Servos of the simulated robot: behind the watchdog, and on an emulated bus."""

import os
import sys

import numpy as np
import pytest
import rod_robots

from slot_core import config
from slot_core.clock import SECOND
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.table import Mode
from slot_core.robot import LEGS
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action
from slot_core.safety.watchdog import NO_LIMITS, Permission
from slot_core.simulation.simulated_servos import (
    CLOSE_TIMEOUT,
    BusServos,
    DirectServos,
)

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


def run(servos, seconds, action, command=None):
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
    health = run(direct, 0.2, Action.PASS)
    assert (health.action, health.reason) == (Action.HOLD, NO_LIMITS)
    assert health.torque.all()
    assert robot.tendon_angle == pytest.approx(start, abs=0.01)
    direct.watchdog.set_limits(LIMITS)
    health = run(direct, 1.0, Action.PASS, COMMAND)
    assert (health.action, health.reason) == (Action.PASS, "")
    assert (health.voltage == SCENE.supply_voltage).all()
    assert robot.tendon_angle == pytest.approx(COMMAND, abs=1e-3)


def test_tendons_unwind_without_torque_which_comes_back_at_the_angles_of_the_spools(
    direct,
):
    """A robot that is frozen before its first command is released by torque that goes off."""
    robot = direct._plant.robot
    direct.watchdog.set_limits(LIMITS)
    run(direct, 0.01, Action.OFF)
    assert not direct.released  # torque has never been permitted
    run(direct, 0.5, Action.PASS, COMMAND)
    assert not run(direct, 0.05, Action.OFF).torque.any()
    assert direct.released
    partly = robot.tendon_angle
    assert (partly > 0.1).all()
    assert (partly < COMMAND - 0.1).all()
    assert run(direct, 0.01, Action.HOLD).torque.all()
    assert not direct.released
    health = run(direct, 0.5, Action.PASS)  # the old command is not followed
    assert (health.action, health.reason) == (Action.HOLD, "no command yet")
    assert (health.goal == partly).all()
    assert robot.tendon_angle == pytest.approx(partly, abs=1e-3)
    run(direct, 1.0, Action.OFF)
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
