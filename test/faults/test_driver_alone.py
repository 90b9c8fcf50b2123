"""The driver at emulated servos without a graph: refusals, ends, services, and its own rules."""

import signal
import sys

import numpy as np
import pytest
from boss import Boss
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rig import SAG
from std_srvs.srv import SetBool, Trigger

from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.safety.command_gate import Action

DRIVER = "dynamixel_driver"
PULLED = 1.5  # rad
BROKEN_DRIVER = """
from slot_nodes import diagnostics, dynamixel_driver_node
told = diagnostics.to_msg
def to_msg(stamp, session, *rest):
    return told(stamp // (not session.driver.active), session, *rest)
diagnostics.to_msg = to_msg
dynamixel_driver_node.main()
"""


@pytest.fixture(scope="module")
def bench(make_rig):
    return make_rig(only=["sim_robot"])


@pytest.fixture
def rig(bench):
    """Emulated servos without a driver; one that a test starts ends with it."""
    bench.wait_for(bench.bus.exists)
    yield bench
    if DRIVER in bench.children:
        bench.stop(DRIVER)


@pytest.fixture
def boss(rig):
    """Sends permissions, limits and commands to a driver."""
    made = Boss(rig)
    yield made
    made.close()


def start_driver(rig, **options):
    """A driver, configured."""
    begin = rig.now()
    rig.start(DRIVER, **options)
    rig.wait_for(lambda: rig.since("/joint_states", begin), what="no joint states")


def switch(rig, on):
    """Success and message of the torque service."""
    answer = rig.call(SetBool, f"/{DRIVER}/torque", data=on)
    return answer.success, answer.message


def powered(rig, since):
    """Wait until the driver has read back, after a time, that torque is on."""
    rig.wait_for(lambda: any(all(m.torque) for m in rig.since("/servo_health", since)))


@pytest.mark.parametrize(
    ("parameter", "value", "reason"),
    [
        ("joints.ids", "[5, 4, 2, 9]", "servo RR (id 9): ping: "),
        ("servo.model", 1061, "servo FL (id 5): model 1060, expected 1061"),
        ("servo.firmware_min", 46, "servo FL (id 5): firmware 45, expected 46 or newer"),
        ("bus.baud", 57600, "servo FL (id 5): ping: "),
    ],
)
def test_servos_that_are_not_those_expected_are_refused_in_one_line(rig, parameter, value, reason):
    before = len(rig.log_lines(DRIVER))
    rig.start(DRIVER, parameters={parameter: value})
    assert rig.exit_code(DRIVER) == 1
    told = [line for line in rig.log_lines(DRIVER)[before:] if "waiting for" not in line]
    assert len(told) == 1, told
    assert f"servos refused: {reason}" in told[0]
    assert rig.registers("torque_enable") == [0] * 4


def test_a_port_that_does_not_come_is_named(rig):
    nowhere = rig.directory / "nowhere"
    rig.start(DRIVER, parameters={"wait_for_port": 0.5, "bus.port": nowhere})
    assert rig.exit_code(DRIVER) == 1
    assert f"servos refused: {nowhere}: " in rig.log_lines(DRIVER)[-1]


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM, "exception"])
def test_however_the_driver_ends_torque_off_is_read_back(rig, boss, end):
    before = len(rig.log_lines(DRIVER))
    broken = end == "exception"
    start_driver(rig, program=[sys.executable, "-c", BROKEN_DRIVER] if broken else ())
    if broken:
        boss.permission = Action.HOLD
    else:
        boss.lead(PULLED)
        rig.send(DRIVER, end)
    assert rig.exit_code(DRIVER) == int(broken)
    log = "".join(rig.log_lines(DRIVER)[before:])
    assert "torque on" in log
    assert "torque off, confirmed by every servo" in log
    assert rig.registers("torque_enable") == [0] * 4


def test_activation_far_from_the_command_is_no_motion(rig, boss):
    start_driver(rig)
    boss.lead(PULLED)
    boss.permission = Action.OFF
    rig.slack(rig.now())
    before, on = rig.rest(), rig.now()  # the tendons have unwound
    assert np.abs(PULLED - before).min() > 0.5
    boss.permission = Action.HOLD
    powered(rig, on)
    rig.wait_for(lambda: len(rig.since("/joint_states", on)) > 100)
    sag, pull = rig.moved(before, on)
    assert -SAG < sag <= pull < 1.5  # one count, where a position lies between two


def test_the_lifecycle_can_be_driven_by_hand(rig, boss):
    rig.start(DRIVER, parameters={"autostart": False})

    def change(transition):
        request = Transition(id=transition)
        return rig.call(ChangeState, f"/{DRIVER}/change_state", transition=request).success

    begin = rig.now()
    assert not change(Transition.TRANSITION_ACTIVATE)  # it is not configured
    assert change(Transition.TRANSITION_CONFIGURE)
    rig.wait_for(lambda: rig.since("/joint_states", begin))
    rig.wait_for(lambda: change(Transition.TRANSITION_ACTIVATE))  # once the limits have come
    powered(rig, begin)
    end = rig.now()
    assert change(Transition.TRANSITION_DEACTIVATE)
    rig.slack(end)
    assert "torque off, confirmed by every servo" in rig.log_lines(DRIVER)[-1]
    assert change(Transition.TRANSITION_CLEANUP)
    assert rig.registers("torque_enable") == [0] * 4  # the port is free
    again = rig.now()
    assert change(Transition.TRANSITION_CONFIGURE)
    rig.wait_for(lambda: rig.since("/joint_states", again))


def test_without_limits_of_the_supervisor_torque_is_refused(rig):
    start_driver(rig)
    assert switch(rig, True) == (False, "torque refused: no limits of the supervisor yet")
    assert rig.stop(DRIVER) == 0
    assert rig.registers("torque_enable") == [0] * 4


def test_the_torque_service_slackens_and_brings_torque_back(rig, boss):
    start_driver(rig)
    rig.wait_for(lambda: switch(rig, True) == (True, "torque on"))  # once the limits have come
    assert switch(rig, True) == (False, "torque is on already")
    reboot = rig.call(Trigger, f"/{DRIVER}/reboot_rr")
    assert reboot.message == "needs a configured driver, torque off"
    off = rig.now()
    assert switch(rig, False) == (True, "slackening, then torque off")
    assert rig.slack(off).reason == "torque off, after: torque switched off by the operator"
    assert switch(rig, True) == (True, "torque on")


def test_a_zero_that_is_measured_holds_now_and_at_the_next_start(rig):
    start_driver(rig)
    answer = rig.call(Trigger, f"/{DRIVER}/zero_fl")
    assert answer.success, answer.message
    begin = rig.now()
    rig.wait_for(lambda: rig.since("/joint_states", begin))
    assert abs(rig.last("/joint_states").position[0]) < 1.5 * RAD_PER_COUNT
    zero = float(answer.message.split(" at ")[1].split(" deg")[0])
    assert f"zero_deg: [{zero:.2f}, 130.0, " in (rig.config / "dynamixel.yaml").read_text()
    rig.stop(DRIVER)
    start_driver(rig)
    assert abs(rig.last("/joint_states").position[0]) < 1.5 * RAD_PER_COUNT
