"""Servo session: commands, missing messages and faults, with emulated servos of two brands.

A brand of servos in one file runs in simulation as they do.
"""

import numpy as np
import pytest
from real_graph import set_values

from examples.ideal_servos import IdealServos, make_brand
from slot_core import config
from slot_core.config import ConfigError
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.emulator.emulated_legs import EmulatedDynamixels
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.faults import Fault
from slot_core.robot import LEGS, read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action, State
from slot_core.safety.watchdog import Permission
from slot_core.servos import registry
from slot_core.servos.servo_bus import RefusedError
from slot_core.servos.session import ServoSession
from slot_core.simulation.supervised_loop import SupervisedLoop

PERIOD = 0.01  # s
STANDING = np.array([0.1, 0.2, 0.3, 0.4])
SLIGHTLY = STANDING + 0.02
ONE_COUNT = 1.01 * RAD_PER_COUNT
TIMING = read_supervisor().timing


class SessionRig:
    """A session with emulated servos; time passes only in `run` and `sleep`."""

    def __init__(self, brand="dynamixel", angles=STANDING, changes=()):
        settings = config.replace(read_settings(), dict(changes))
        self.servos = (
            IdealServos(angles)
            if brand == "ideal"
            else EmulatedDynamixels(settings, read_emulator(), angles)
        )
        self.time, self.walks = 0.0, False
        self.bus = self.servos.connect(lambda: self.time)
        self.session = self.fresh()
        self.session.watchdog.set_limits(read_supervisor().servo_limits)
        self.session.configure()
        self.permit(Action.HOLD)
        self.session.start()

    def fresh(self):
        """A session on the bus that nobody has told anything yet."""
        return ServoSession(
            self.bus, read_robot().tendon.angle_max, PERIOD, self.sleep
        )

    @property
    def now(self):
        return round(self.time * 1e9)

    def sleep(self, duration):
        self.servos.advance(duration)
        self.time += duration

    def permit(self, action, reason="the supervisor's reason"):
        self.session.permit(
            Permission(self.now, action, True, reason, walks=self.walks)
        )

    def run(self, duration, angle=None, permission=Action.PASS):
        """Steps for a time (s), each with permission and command; returns (action, s) changes."""
        changes = []
        for _ in range(round(duration / PERIOD)):
            before = self.session.action
            if permission is not None:
                self.permit(permission)
            if angle is not None:
                self.session.offer(self.now, self.now, angle)
            self.cycle = self.session.step(self.now)
            if self.session.action is not before:
                changes.append((self.session.action, self.time))
            self.sleep(PERIOD)
        return changes

    def inject(self, kind, leg):
        self.servos.set_fault(Fault(kind, leg, 0.0, 0.0, 0.0), True)


@pytest.fixture(params=["dynamixel", "ideal"])
def rig(request):
    return SessionRig(request.param)


@pytest.fixture
def dynamixels():
    return SessionRig()


def test_torque_comes_on_without_motion_below_the_range_of_commands():
    beyond = np.array([-0.03, 0.2, -0.02, 0.4])
    rig = SessionRig("dynamixel", beyond)
    rig.run(0.3, SLIGHTLY, Action.HOLD)
    assert rig.servos.angles() == pytest.approx(beyond, abs=ONE_COUNT)


def test_configure_switches_off_torque_left_on_by_a_killed_driver(rig):
    """Also if it is refused."""
    rig.run(0.2, SLIGHTLY)
    rig.bus.close()  # as the kernel does after a kill
    rig.sleep(1.0)
    assert rig.servos.powered() == LEGS
    rig.session.configure()
    assert rig.servos.powered() == ()
    rig.permit(Action.HOLD)
    rig.session.start()
    rig.inject("silent", "FL")
    with pytest.raises(RefusedError, match="FL"):
        rig.session.configure()
    assert set(rig.servos.powered()) <= {"FL"}


def test_torque_is_refused_without_limits_or_a_fresh_permission(rig):
    rig.session.stop()
    rig.session = rig.fresh()
    rig.permit(Action.PASS)
    assert "no limits" in rig.session.offer(rig.now, rig.now, SLIGHTLY)
    rig.session.step(rig.now)
    with pytest.raises(RefusedError, match="no limits of the supervisor yet"):
        rig.session.start()
    rig.session.watchdog.set_limits(read_supervisor().servo_limits)
    with pytest.raises(RefusedError, match="the supervisor does not permit it"):
        rig.session.start()
    rig.permit(Action.HOLD)
    rig.sleep(TIMING.command_hold + 0.1)
    with pytest.raises(RefusedError, match=r"permission is 0\.\d+ s old"):
        rig.session.start()
    assert rig.servos.powered() == ()
    rig.permit(Action.HOLD)
    assert rig.session.may_start(rig.session.watchdog.permission)
    rig.session.start()
    assert rig.servos.powered() == LEGS


def test_commands_reach_the_servos_and_their_stamp_is_recorded_once(rig):
    rig.permit(Action.PASS)
    rig.session.offer(rig.now, 123, SLIGHTLY)
    rig.session.step(rig.now)
    assert (rig.session.commanded, rig.session.written) == (123, rig.time)
    rig.run(0.05)
    assert (rig.session.commanded, rig.session.written) == (123, 0.0)
    rig.run(0.5, SLIGHTLY)
    assert rig.bus.goals() == pytest.approx(SLIGHTLY)
    assert rig.servos.angles() == pytest.approx(SLIGHTLY, abs=0.01)
    with pytest.raises(RefusedError, match="torque is on already"):
        rig.session.start()


def test_permission_off_switches_torque_off_before_the_next_cycle(rig):
    rig.run(0.2, SLIGHTLY)
    rig.permit(Action.OFF, "e-stop pressed")
    assert rig.servos.powered() == ()
    assert rig.session.reason == "torque off, after: e-stop pressed"


@pytest.mark.parametrize("kind", ["overload", "watchdog"])
def test_a_fault_of_one_servo_relaxes_all_and_is_named(dynamixels, kind):
    dynamixels.run(0.2, SLIGHTLY)
    dynamixels.inject(kind, "RL")
    actions = [action for action, _ in dynamixels.run(2.0, SLIGHTLY)]
    assert actions == [Action.RELAX, Action.OFF]
    assert "servo RL (id 2): " in dynamixels.session.reason
    assert dynamixels.servos.powered() == ()
    hold = Permission(dynamixels.now, Action.HOLD, True, "")
    # until the permission has been OFF
    assert not dynamixels.session.may_start(hold)
    dynamixels.permit(Action.OFF)
    assert dynamixels.session.may_start(hold)


def test_a_bus_watchdog_that_a_late_cycle_has_tripped_is_reported_with_the_delay(
    dynamixels,
):
    dynamixels.run(0.2, SLIGHTLY)
    dynamixels.sleep(0.15)
    dynamixels.run(1.0, SLIGHTLY)
    assert dynamixels.session.overruns == 1
    assert dynamixels.session.watchdog.own_reason == (
        "servo FL (id 5): stopped by its bus watchdog after 0.16 s without a bus cycle"
    )


def test_a_silent_servo_has_no_joint_reading_and_relaxes_all_after_its_limit(
    rig,
):
    rig.run(0.2, SLIGHTLY)
    assert rig.cycle.joints(7, np.full(4, 1.4)).angle == pytest.approx(
        rig.servos.angles(), abs=0.02
    )
    rig.inject("silent", "RR")
    (action, when), *_ = rig.run(TIMING.servo_silent + 0.1, SLIGHTLY)
    assert rig.cycle.joints(8, np.full(4, 1.4)) is None
    assert action is Action.RELAX
    assert when - 0.2 == pytest.approx(TIMING.servo_silent, abs=2 * PERIOD)
    assert rig.session.reason.startswith("servo RR (id ")
    assert "no answer for 0.5" in rig.session.reason


def test_stop_relaxes_and_confirms_also_during_an_exchange(dynamixels):
    dynamixels.run(0.2, SLIGHTLY)
    dynamixels.bus.bus.port.is_using = True  # as an interrupt leaves it
    assert dynamixels.session.stop().complete
    assert dynamixels.servos.powered() == ()
    # with the gains of dynamixel.yaml the servos follow the ramp of 2 rad/s 0.05 rad behind
    assert dynamixels.servos.angles() == pytest.approx(np.zeros(4), abs=0.1)
    assert dynamixels.session.action is Action.OFF


def test_an_interrupted_stop_switches_torque_off(rig):
    rig.run(0.2, SLIGHTLY)

    def interrupt(duration):
        raise KeyboardInterrupt

    rig.session._sleep = interrupt
    with pytest.raises(KeyboardInterrupt):
        rig.session.stop()
    assert rig.servos.powered() == ()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (
            "joints.low_deg",
            10.0,
            r"range \[10, 116\.28\] deg, smaller than that of the tendon",
        ),
        (
            "joints.high_deg",
            100.0,
            r"range \[0, 100\] deg, smaller .* robot\.yaml instead",
        ),
    ],
)
def test_a_range_smaller_than_the_tendons_is_refused(name, value, message):
    """The gait and the force map would send commands beyond it, and the robot would stop."""
    with pytest.raises(config.ConfigError, match=message):
        SessionRig("dynamixel", np.full(4, 0.5), {name: value})


def test_the_robot_stands_on_servos_of_another_brand(own_config, monkeypatch):
    monkeypatch.setitem(registry.BRANDS, "ideal", make_brand)
    set_values(own_config, {"servo_bus": {"brand": "ideal"}})
    loop = SupervisedLoop("flat", "stand", None, 0, hardware="fake_bus")
    reports = list(loop.run(3.0))
    assert reports[-1].state is State.STANDING
    assert reports[-1].followed
    assert loop.servos.session.bus.facts.brand == "ideal"
    assert loop.plant.robot.position[2] == pytest.approx(0.04, abs=2e-3)
    assert loop.servos.close(running=True) == ""


@pytest.mark.parametrize(
    ("brand", "reason"),
    [
        ("other", r"brand = 'other': expected one of dynamixel"),
        ("bare", "cannot be emulated"),
    ],
)
def test_a_brand_that_is_unknown_or_has_no_emulator_cannot_be_simulated(
    own_config, monkeypatch, brand, reason
):
    bare = registry.Brand(lambda: None, lambda settings: None)
    monkeypatch.setitem(registry.BRANDS, "bare", lambda: bare)
    set_values(own_config, {"servo_bus": {"brand": brand}})
    with pytest.raises(ConfigError, match=reason):
        SupervisedLoop("flat", "stand", None, 0, hardware="fake_bus")
    with pytest.raises(ConfigError, match="have no tools"):
        bare.tools([])
