"""Servos of the simulated robot: behind the command watchdog, and on an emulated bus."""

import dataclasses
import math
import os
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from slot_core import config
from slot_core.clock import SECOND
from slot_core.config import ConfigError
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.settings import read_settings
from slot_core.emulator.emulated_bus import read_emulator
from slot_core.robot import LEGS, read_robot
from slot_core.safety.command_gate import Action
from slot_core.safety.command_guard import NO_LIMITS
from slot_core.safety.command_watchdog import Permission
from slot_core.safety.settings import read_supervisor
from slot_core.simulation.bus_plant import BusPlant
from slot_core.simulation.plant import Plant
from slot_core.simulation.simulated_servos import (
    CLOSE_TIMEOUT,
    BusServos,
    GuardedServos,
)

ROBOT = read_robot()
SCENE = config.replace(read_scene("map"), {"start.settle": 0.5})
LIMITS = read_supervisor().servo_limits
TICK = 10_000_000  # ns, a whole number of time steps
# A servo that reaches its goal under load; the bus's position loop stays 2 deg below it.
SERVO = config.replace(read_servo(), {"model": "torque_speed"})
COMMAND = np.array([1.3, 1.0, 0.9, 1.2])  # rad, within 0.3 rad of the start
OUT_OF_RANGE = [
    (np.array([-0.1, 1.0, 1.0, 1.0]), "FL"),
    (np.array([1.0, 1.0, math.nan, 1.0]), "RL"),
    (np.array([1.0, 1.0, 1.0, ROBOT.tendon.angle_max + 0.01]), "RR"),
]


def make_plant():
    return Plant(ROBOT, SCENE, SERVO, np.random.default_rng(0))


def changed(limits, **gate):
    """Limits with other settings of the gate."""
    return dataclasses.replace(limits, gate=dataclasses.replace(limits.gate, **gate))


class Guarded:
    """Guarded servos on a running robot, stepped every TICK under a constant permission."""

    def __init__(self, limits=LIMITS):
        self.plant = make_plant()
        self.servos = GuardedServos(self.plant)
        self.plant.start(SECOND)
        if limits is not None:
            self.servos.set_limits(limits)

    @property
    def angle(self):
        """(4,) rad, angles of the spools."""
        return self.plant.simulator.tendon_angle

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
        return [self.tick(action, command) for _ in range(round(seconds * SECOND / TICK))][-1]


@pytest.fixture
def guarded():
    return Guarded()


def test_without_limits_guarded_servos_hold_and_refuse_commands():
    guarded = Guarded(limits=None)
    start = guarded.angle
    guarded.permit(Action.PASS)
    with pytest.raises(ValueError, match=NO_LIMITS):
        guarded.offer(COMMAND)
    assert not guarded.servos.follows(guarded.plant.now)
    assert guarded.servos.clock_jump == math.inf
    health = guarded.run(0.2, Action.PASS)
    assert (health.action, health.reason) == (Action.HOLD, NO_LIMITS)
    assert health.torque.all()
    assert guarded.angle == pytest.approx(start, abs=0.01)


def test_without_a_permission_guarded_servos_hold(guarded):
    guarded.offer(COMMAND)
    health = guarded.step()
    assert health.action is Action.HOLD
    assert not guarded.servos.follows(guarded.plant.now)


def test_under_pass_guarded_servos_follow_commands(guarded):
    health = guarded.run(1.0, Action.PASS, COMMAND)
    assert (health.action, health.reason) == (Action.PASS, "")
    assert guarded.servos.follows(guarded.plant.now)
    assert guarded.angle == pytest.approx(COMMAND, abs=1e-3)


def test_under_hold_guarded_servos_keep_their_goals(guarded):
    guarded.run(0.05, Action.PASS, COMMAND)
    goal = guarded.step().goal
    health = guarded.run(0.5, Action.HOLD, COMMAND)
    assert health.action is Action.HOLD
    assert (health.goal == goal).all()
    assert guarded.angle == pytest.approx(goal, abs=1e-3)


def test_health_reports_the_supply_voltage_of_the_scene(guarded):
    assert (guarded.step().voltage == SCENE.supply_voltage).all()


def test_health_reports_goal_slewed_and_torque(guarded):
    """The goals move at approach_rate; those that have not arrived are slewed."""
    previous, rate = guarded.angle, LIMITS.gate.approach_rate
    first = guarded.tick(Action.PASS, COMMAND)  # without elapsed time
    assert (first.goal == previous).all()
    assert first.slewed.all()
    for _ in range(50):
        health = guarded.tick(Action.PASS, COMMAND)
        step = np.abs(health.goal - previous)
        assert (step <= rate * (TICK / SECOND + LIMITS.gate.burst) + 1e-12).all()
        assert (health.slewed == (health.goal != COMMAND)).all()
        assert health.torque.all()
        assert (health.silence == 0.0).all()
        previous = health.goal
    assert (health.goal == COMMAND).all()


def test_under_off_torque_is_off_and_the_tendons_unwind(guarded):
    guarded.run(0.5, Action.PASS, COMMAND)
    health = guarded.tick(Action.OFF)
    assert health.action is Action.OFF
    assert not health.torque.any()
    guarded.run(1.0, Action.OFF)
    assert guarded.angle == pytest.approx(np.zeros(4), abs=1e-3)
    assert guarded.plant.simulator.tension == pytest.approx(np.zeros(4), abs=1e-6)


def test_torque_back_on_engages_at_the_angles_of_the_spools(guarded):
    guarded.run(0.5, Action.PASS, COMMAND)
    guarded.run(0.05, Action.OFF)
    partly = guarded.angle
    assert (partly > 0.1).all()
    assert (partly < COMMAND - 0.1).all()
    health = guarded.tick(Action.HOLD)
    assert health.torque.all()
    assert (health.goal == partly).all()
    health = guarded.run(0.5, Action.HOLD)
    assert (health.goal == partly).all()
    assert guarded.angle == pytest.approx(partly, abs=1e-3)


def test_after_torque_is_back_on_the_old_command_is_not_followed(guarded):
    guarded.run(0.5, Action.PASS, COMMAND)
    guarded.run(0.05, Action.OFF)
    partly = guarded.angle
    health = guarded.tick(Action.PASS)
    assert (health.action, health.reason) == (Action.HOLD, "no command yet")
    assert (health.goal == partly).all()


def test_other_limits_apply_and_keep_the_goals(guarded):
    """The goals go on from where they are, at the new rate."""
    guarded.tick(Action.HOLD)
    before = guarded.tick(Action.PASS, COMMAND).goal
    slow = changed(LIMITS, approach_rate=LIMITS.gate.approach_rate / 10)
    guarded.servos.set_limits(dataclasses.replace(slow, clock_jump=0.25))
    assert guarded.servos.clock_jump == 0.25
    health = guarded.run(0.1, Action.PASS, COMMAND)
    # the first of ten steps has no elapsed time, because the gate is new
    moved = np.abs(health.goal - before)
    assert moved == pytest.approx(np.full(4, slow.gate.approach_rate * 0.09), abs=1e-9)
    assert health.slewed.all()


def test_limits_with_too_short_a_relax_time_are_refused(guarded):
    with pytest.raises(ConfigError, match=r"gate\.relax_time = 0\.1"):
        guarded.servos.set_limits(changed(LIMITS, relax_time=0.1))
    assert guarded.servos.clock_jump == LIMITS.clock_jump


@pytest.mark.parametrize(("angle", "leg"), OUT_OF_RANGE)
def test_guarded_servos_refuse_a_command_out_of_range_as_a_whole(guarded, angle, leg):
    guarded.run(1.0, Action.PASS, COMMAND)
    with pytest.raises(ValueError, match=rf"command {leg} = .* rad is not inside \[0, 2\.029\]"):
        guarded.offer(angle)
    assert (guarded.tick(Action.PASS).goal == COMMAND).all()


@pytest.fixture
def bus(tmp_path):
    """Bus servos at a pseudo-terminal, with their simulated robot."""
    interval = sys.getswitchinterval()
    rng = np.random.default_rng(0)
    plant = BusPlant(
        ROBOT, SCENE, read_servo(), rng, settings=read_settings(), emulator=read_emulator()
    )
    servos = BusServos(plant, tmp_path / "servos")
    yield servos, plant
    servos.close(running=False)
    sys.setswitchinterval(interval)


def set_torque(plant, *legs):
    """Torque on at the servos of `legs`, off at the others."""
    for leg, servo in zip(LEGS, plant.legs.bus.servos):
        servo.memory["torque_enable"] = leg in legs


def test_bus_servos_are_powered_only_when_all_torque_is_on(bus):
    servos, plant = bus
    for legs in ((), ("FL",), ("FL", "FR", "RL"), LEGS, ("FR", "RL", "RR")):
        set_torque(plant, *legs)
        assert servos.powered == servos.follows(0) == (legs == LEGS)


def test_bus_servos_check_the_range_of_commands_and_do_not_apply_them(bus):
    servos, plant = bus
    plant.start(0)
    set_torque(plant, *LEGS)
    for joint, servo, angle in zip(
        plant.legs.joints, plant.legs.bus.servos, plant.simulator.tendon_angle
    ):
        servo.memory["goal_position"] = joint.counts(angle)
    before = plant.simulator.tendon_angle
    servos.offer(0, 0, np.full(4, 2.0))
    servos.step(0)
    list(plant.advance(10 * TICK))
    # they hold the goal in the register, but for the error of a proportional controller
    assert plant.simulator.tendon_angle == pytest.approx(before, abs=0.2)
    with pytest.raises(ValueError, match="is not inside"):
        servos.offer(0, 0, np.full(4, -0.1))


def test_bus_servos_at_the_end_name_the_legs_left_under_torque(bus, tmp_path):
    servos, plant = bus
    set_torque(plant, "FR", "RL")
    assert (tmp_path / "servos").exists()
    assert servos.close(running=False) == "FR, RL"
    assert not (tmp_path / "servos").exists()
    set_torque(plant)
    assert servos.close(running=False) == ""


@pytest.mark.parametrize("running", [True, False])
def test_the_robot_advances_in_real_time_while_bus_servos_close_if_it_is_running(bus, running):
    servos, plant = bus
    plant.start(0)
    servos.close(running=running)
    assert (plant.now > 0) == running
    assert plant.now < CLOSE_TIMEOUT * SECOND


def test_bus_servos_do_not_replace_a_file(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="file: exists already"):
        BusServos(SimpleNamespace(legs=SimpleNamespace(bus=None)), tmp_path / "file")


def test_bus_servos_replace_the_link_of_a_pseudo_terminal(bus, tmp_path):
    _, plant = bus
    ends = os.openpty()
    link = tmp_path / "old"
    link.symlink_to(os.ttyname(ends[1]))
    servos = BusServos(plant, link)
    assert link.resolve() != (tmp_path / os.ttyname(ends[1])).resolve()
    servos.close(running=False)
    for end in ends:
        os.close(end)


def test_torque_that_goes_off_after_it_was_permitted_releases_the_tendons(guarded):
    """A robot that is frozen before its first command then has to unwind."""
    guarded.permit(Action.OFF)
    guarded.step()
    assert not guarded.servos.released  # torque has never been permitted
    guarded.permit(Action.HOLD)
    guarded.step(TICK)
    assert not guarded.servos.released
    guarded.permit(Action.OFF)
    assert not guarded.step(2 * TICK).torque.any()
    assert guarded.servos.released
    guarded.permit(Action.HOLD)
    guarded.step(3 * TICK)
    assert not guarded.servos.released
