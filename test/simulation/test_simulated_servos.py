"""Servos of the simulated robot: behind the watchdog, and on an emulated bus."""

import math
import os
import sys

import numpy as np
import pytest

from slot_core import config
from slot_core.clock import SECOND
from slot_core.config import ConfigError
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.table import Mode
from slot_core.robot import LEGS, read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action
from slot_core.safety.watchdog import NO_LIMITS, Permission
from slot_core.servos.registry import read_brand
from slot_core.simulation.plant import RobotSimulator
from slot_core.simulation.simulated_servos import CLOSE_TIMEOUT, BusServos, DirectServos

ROBOT = read_robot()
SCENE = config.replace(read_scene("map"), {"start.settle": 0.5})
LIMITS = read_supervisor().servo_limits
TICK = 10_000_000  # ns, a whole number of time steps
# A servo that reaches its goal under load; the bus's position loop stays 2 deg below it.
SERVO = config.replace(read_servo(), {"model": "torque_speed"})
COMMAND = np.array([1.3, 1.0, 0.9, 1.2])  # rad, within 0.3 rad of the start


def make_plant():
    return RobotSimulator(ROBOT, SCENE, SERVO, np.random.default_rng(0))


class DirectRig:
    """Direct servos on a running robot, stepped every TICK under a constant permission."""

    def __init__(self, limits=LIMITS):
        self.plant = make_plant()
        self.servos = DirectServos(self.plant)
        self.plant.start(SECOND)
        if limits is not None:
            self.servos.watchdog.set_limits(limits)

    @property
    def angle(self):
        """(4,) rad, angles of the spools."""
        return self.plant.robot.tendon_angle

    def offer(self, angle):
        self.servos.offer(self.plant.now, self.plant.now, angle)

    def permit(self, action):
        self.servos.permit(Permission(self.plant.now, action, False, "test"))

    def step(self, later=0):
        """One step of the servos `later` (ns); their health."""
        self.servos.step(self.plant.now + later)
        return self.servos.health(self.plant.now + later)

    def tick(self, action, command=None):
        """Permission, command and one step of servos and robot; the health of the servos."""
        self.permit(action)
        if command is not None:
            self.offer(command)
        health = self.step()
        list(self.plant.advance(self.plant.now + TICK))
        return health

    def run(self, seconds, action, command=None):
        """The health after `seconds`."""
        return [
            self.tick(action, command) for _ in range(round(seconds * SECOND / TICK))
        ][-1]


@pytest.fixture
def direct():
    return DirectRig()


def test_without_limits_direct_servos_hold_and_refuse_commands():
    direct = DirectRig(limits=None)
    start = direct.angle
    direct.permit(Action.PASS)
    with pytest.raises(ValueError, match=NO_LIMITS):
        direct.offer(COMMAND)
    assert direct.servos.watchdog.clock_jump == math.inf
    health = direct.run(0.2, Action.PASS)
    assert (health.action, health.reason) == (Action.HOLD, NO_LIMITS)
    assert health.torque.all()
    assert direct.angle == pytest.approx(start, abs=0.01)


def test_under_pass_direct_servos_follow_commands(direct):
    health = direct.run(1.0, Action.PASS, COMMAND)
    assert (health.action, health.reason) == (Action.PASS, "")
    assert health.torque.all()
    assert (health.voltage == SCENE.supply_voltage).all()
    with pytest.raises(ValueError, match=r"command RL = nan rad is not inside"):
        direct.offer(np.array([1.0, 1.0, math.nan, 1.0]))
    assert direct.angle == pytest.approx(COMMAND, abs=1e-3)


def test_under_off_torque_is_off_and_the_tendons_unwind(direct):
    direct.run(0.5, Action.PASS, COMMAND)
    health = direct.tick(Action.OFF)
    assert health.action is Action.OFF
    assert not health.torque.any()
    direct.run(1.0, Action.OFF)
    assert direct.angle == pytest.approx(np.zeros(4), abs=1e-3)
    assert direct.plant.robot.tension == pytest.approx(np.zeros(4), abs=1e-6)


def test_torque_back_on_engages_at_the_angles_of_the_spools(direct):
    direct.run(0.5, Action.PASS, COMMAND)
    direct.run(0.05, Action.OFF)
    partly = direct.angle
    assert (partly > 0.1).all()
    assert (partly < COMMAND - 0.1).all()
    health = direct.tick(Action.HOLD)
    assert health.torque.all()
    assert (health.goal == partly).all()
    health = direct.run(0.5, Action.PASS)  # the old command is not followed
    assert (health.action, health.reason) == (Action.HOLD, "no command yet")
    assert (health.goal == partly).all()
    assert direct.angle == pytest.approx(partly, abs=1e-3)


@pytest.fixture
def bus(tmp_path):
    """Bus servos at a pseudo-terminal, with their simulated robot."""
    interval = sys.getswitchinterval()
    rng = np.random.default_rng(0)
    plant = RobotSimulator(ROBOT, SCENE, read_servo(), rng, read_brand().emulate)
    servos = BusServos(plant, link=tmp_path / "servos")
    yield servos, plant
    servos.close(running=False)
    sys.setswitchinterval(interval)


def set_torque(plant, *legs):
    """Torque on at the servos of `legs`, off at the others."""
    for leg, servo in zip(LEGS, plant.emulated.bus.servos):
        servo.memory["torque_enable"] = leg in legs


def test_bus_servos_are_powered_only_when_all_torque_is_on(bus):
    servos, plant = bus
    for legs in ((), ("FL",), ("FL", "FR", "RL"), LEGS, ("FR", "RL", "RR")):
        set_torque(plant, *legs)
        assert servos.powered == (legs == LEGS)


def test_bus_servos_move_when_the_driver_moves_them_or_takes_torque_away(bus):
    """In real time; a command that only the driver has received counts."""
    servos, plant = bus
    memory = plant.emulated.bus.servos[2].memory

    def moving():
        servos.step(0)
        return servos.moving

    memory["goal_position"] += 1
    assert not moving()  # without torque
    memory["goal_position"] -= 1
    set_torque(plant, *LEGS)
    assert not moving()
    memory["goal_position"] += 1
    assert moving()
    memory["goal_position"] -= 1
    assert not moving()
    set_torque(plant, "FL", "FR", "RR")
    assert moving()


def test_a_duty_moves_a_servo_under_torque(bus):
    servos, plant = bus
    set_torque(plant, *LEGS)
    for servo in plant.emulated.bus.servos:
        servo.memory["operating_mode"], servo.memory["goal_pwm"] = Mode.PWM, 0
    assert not servos.moving
    plant.emulated.bus.servos[0].memory["goal_pwm"] = 1
    assert servos.moving


def test_bus_servos_at_the_end_name_the_legs_left_under_torque(bus, tmp_path):
    servos, plant = bus
    set_torque(plant, "FR", "RL")
    assert (tmp_path / "servos").exists()
    assert servos.close(running=False) == "FR, RL"
    assert not (tmp_path / "servos").exists()
    set_torque(plant)
    assert servos.close(running=False) == ""


@pytest.mark.parametrize("running", [True, False])
def test_the_robot_advances_in_real_time_while_bus_servos_close_if_it_is_running(
    bus, running
):
    servos, plant = bus
    plant.start(0)
    servos.close(running=running)
    assert (plant.now > 0) == running
    assert plant.now < CLOSE_TIMEOUT * SECOND


def test_bus_servos_do_not_replace_a_file(bus, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="file: exists already"):
        BusServos(bus[1], link=tmp_path / "file")


def test_bus_servos_replace_the_link_of_a_pseudo_terminal(bus, tmp_path):
    _, plant = bus
    ends = os.openpty()
    link = tmp_path / "old"
    link.symlink_to(os.ttyname(ends[1]))
    servos = BusServos(plant, link=link)
    assert link.resolve() != (tmp_path / os.ttyname(ends[1])).resolve()
    servos.close(running=False)
    for end in ends:
        os.close(end)


def test_torque_that_goes_off_after_it_was_permitted_releases_the_tendons(direct):
    """A robot that is frozen before its first command then has to unwind."""
    direct.permit(Action.OFF)
    direct.step()
    assert not direct.servos.released  # torque has never been permitted
    direct.permit(Action.HOLD)
    direct.step(TICK)
    assert not direct.servos.released
    direct.permit(Action.OFF)
    assert not direct.step(2 * TICK).torque.any()
    assert direct.servos.released
    direct.permit(Action.HOLD)
    direct.step(3 * TICK)
    assert not direct.servos.released
