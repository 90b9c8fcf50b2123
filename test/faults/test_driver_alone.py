"""Driver with emulated servos, without the rest of the graph: refusals, exits, services."""

import signal
import sys

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rig import SAG
from std_srvs.srv import SetBool, Trigger
from stub_supervisor import StubSupervisor

from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.safety.command_gate import Action

DRIVER = "dynamixel_driver"
PULLED = 1.5  # rad
# Raises ZeroDivisionError in its first diagnostics under torque.
BROKEN_DRIVER = """
from slot_nodes import diagnostics, dynamixel_driver_node
original = diagnostics.to_msg
def to_msg(stamp, session, *rest):
    return original(stamp // (not session.driver.active), session, *rest)
diagnostics.to_msg = to_msg
dynamixel_driver_node.main()
"""


@pytest.fixture(scope="module")
def bench(make_rig):
    return make_rig(only=["sim_robot"])


@pytest.fixture
def rig(bench):
    """Emulated servos without a driver; a driver that the test starts ends with it."""
    bench.wait_for(bench.bus.exists)
    yield bench
    if DRIVER in bench.children:
        bench.stop(DRIVER)


@pytest.fixture
def stub(rig):
    """Permissions, limits and commands for a driver."""
    made = StubSupervisor(rig)
    yield made
    made.close()


def start_driver(rig, **options):
    """Start a driver, and wait until it is configured."""
    begin = rig.now()
    rig.start(DRIVER, **options)
    rig.wait_for(lambda: rig.since("/joint_states", begin), what="no joint states")


def switch(rig, on):
    """Call the torque service; returns success and message."""
    answer = rig.call(SetBool, f"/{DRIVER}/torque", data=on)
    return answer.success, answer.message


def powered(rig, since):
    """Wait for a health report since a time with every torque on."""
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
def test_unexpected_servos_are_refused_in_one_line(rig, parameter, value, reason):
    before = len(rig.log_lines(DRIVER))
    rig.start(DRIVER, parameters={parameter: value})
    assert rig.exit_code(DRIVER) == 1
    lines = [line for line in rig.log_lines(DRIVER)[before:] if "waiting for" not in line]
    assert len(lines) == 1, lines
    assert f"servos refused: {reason}" in lines[0]
    assert rig.registers("torque_enable") == [0] * 4


def test_a_port_that_does_not_appear_is_named(rig):
    missing = rig.directory / "missing"
    rig.start(DRIVER, parameters={"wait_for_port": 0.5, "bus.port": missing})
    assert rig.exit_code(DRIVER) == 1
    assert f"servos refused: {missing}: " in rig.log_lines(DRIVER)[-1]


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM, "exception"])
def test_the_driver_reads_torque_off_back_before_it_ends(rig, stub, end):
    before = len(rig.log_lines(DRIVER))
    broken = end == "exception"
    start_driver(rig, program=[sys.executable, "-c", BROKEN_DRIVER] if broken else ())
    if broken:
        stub.permission = Action.HOLD
    else:
        stub.move_to(PULLED)
        rig.send_signal(DRIVER, end)
    assert rig.exit_code(DRIVER) == int(broken)
    log = "".join(rig.log_lines(DRIVER)[before:])
    assert "torque on" in log
    assert "torque off, confirmed by every servo" in log
    assert rig.registers("torque_enable") == [0] * 4


def test_torque_comes_on_without_motion_far_from_the_command(rig, stub):
    start_driver(rig)
    stub.move_to(PULLED)
    stub.permission = Action.OFF
    rig.wait_for_torque_off(rig.now())
    before, on = rig.wait_for_rest(), rig.now()  # the tendons are slack
    assert np.abs(PULLED - before).min() > 0.5
    stub.permission = Action.HOLD
    powered(rig, on)
    rig.wait_for(lambda: len(rig.since("/joint_states", on)) > 100)
    sag, pull = rig.moved(before, on)
    assert -SAG < sag <= pull < 1.5  # 1 count of a position between two


def test_the_driver_follows_lifecycle_transitions_by_service(rig, stub):
    rig.start(DRIVER, parameters={"autostart": False})

    def change(transition):
        request = Transition(id=transition)
        return rig.call(ChangeState, f"/{DRIVER}/change_state", transition=request).success

    begin = rig.now()
    assert not change(Transition.TRANSITION_ACTIVATE)  # it is not configured
    assert change(Transition.TRANSITION_CONFIGURE)
    rig.wait_for(lambda: rig.since("/joint_states", begin))
    rig.wait_for(lambda: change(Transition.TRANSITION_ACTIVATE))  # once it has the limits
    powered(rig, begin)
    end = rig.now()
    assert change(Transition.TRANSITION_DEACTIVATE)
    rig.wait_for_torque_off(end)
    assert "torque off, confirmed by every servo" in rig.log_lines(DRIVER)[-1]
    assert change(Transition.TRANSITION_CLEANUP)
    assert rig.registers("torque_enable") == [0] * 4  # the driver has closed the port
    again = rig.now()
    assert change(Transition.TRANSITION_CONFIGURE)
    rig.wait_for(lambda: rig.since("/joint_states", again))


def test_without_limits_of_the_supervisor_torque_is_refused(rig):
    start_driver(rig)
    assert switch(rig, True) == (False, "torque refused: no limits of the supervisor yet")
    assert rig.stop(DRIVER) == 0
    assert rig.registers("torque_enable") == [0] * 4


def test_the_torque_service_switches_torque_off_after_a_ramp_and_on_again(rig, stub):
    start_driver(rig)
    rig.wait_for(lambda: switch(rig, True) == (True, "torque on"))  # once it has the limits
    assert switch(rig, True) == (False, "torque is on already")
    reboot = rig.call(Trigger, f"/{DRIVER}/reboot_rr")
    assert reboot.message == "needs a configured driver, torque off"
    begin = rig.now()
    assert switch(rig, False) == (True, "slackening, then torque off")
    off = rig.wait_for_torque_off(begin)
    assert off.reason == "torque off, after: torque switched off by the operator"
    assert switch(rig, True) == (True, "torque on")


def test_a_measured_zero_applies_at_once_and_after_a_restart(rig):
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
