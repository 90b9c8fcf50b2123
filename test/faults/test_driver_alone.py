"""The driver at emulated servos without a graph: refusals, ends, services, and its own rules."""

import signal
import sys

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rig import LATE, PATIENT, SAG
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from slot_core import decode
from slot_core.control.command_gate import Action
from slot_core.control.supervisor_table import State
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_msgs.msg import RobotState
from slot_nodes import messages, qos

DRIVER = "dynamixel_driver"
PULLED = 1.5  # rad
# The time limits of the driver itself are those of config/; only the bus is given more time.
PROMPT = {"dynamixel.yaml": {"  timeout: 0.008": "  timeout: 0.05"}}
BROKEN_DRIVER = """
from slot_nodes import diagnostics, dynamixel_driver_node
told = diagnostics.to_msg
def to_msg(stamp, session, *rest):
    return told(stamp / (not session.driver.active), session, *rest)
diagnostics.to_msg = to_msg
dynamixel_driver_node.main()
"""


class Boss:
    """Supervisor and controller in one: repeats a word and a command every 20 ms."""

    def __init__(self, rig):
        self.word, self.angle = None, None
        self.commanded = self.spoken = 0  # ns, before the last of each
        self._rig = rig
        self._words = rig.node.create_publisher(RobotState, "robot_state", qos.STATE)
        self._commands = rig.node.create_publisher(JointState, "desired_joint_angles", qos.CONTROL)
        self._timer = rig.node.create_timer(0.02, self._tick)

    def _tick(self):
        now = self._rig.now()
        if (word := self.word) is not None:
            self.spoken = now
            action = decode.ACTIONS.index(word)
            told = RobotState(state=State.WALKING, action=action, reason="the boss says so")
            told.header.stamp = messages.ns_to_stamp(now)
            self._words.publish(told)
        if (angle := self.angle) is not None:
            self.commanded = now
            self._commands.publish(messages.command_to_msg(now, np.full(4, angle)))

    def close(self):
        self._rig.node.destroy_timer(self._timer)
        self._rig.node.destroy_publisher(self._words)
        self._rig.node.destroy_publisher(self._commands)


@pytest.fixture(scope="module")
def patient(make_rig):
    return make_rig(only=["sim_robot"], config=PATIENT)


@pytest.fixture(scope="module")
def prompt(make_rig):
    return make_rig(only=["sim_robot"], config=PROMPT)


def with_driver(rig):
    """A driver at the rig's servos and a boss, until the test is over."""
    begin = rig.now()
    rig.start(DRIVER)
    rig.wait_for(lambda: rig.since("/joint_states", begin))
    boss = Boss(rig)
    yield rig, boss
    boss.close()
    rig.stop(DRIVER)


@pytest.fixture
def driven(patient):
    yield from with_driver(patient)


@pytest.fixture
def prompted(prompt):
    yield from with_driver(prompt)


def switch(rig, on):
    """Success and message of the torque service."""
    answer = rig.call(SetBool, f"/{DRIVER}/torque", data=on)
    return answer.success, answer.message


def powered(rig):
    """Wait until the driver has read back that torque is on."""
    rig.wait_for(lambda: all(rig.last("/servo_health").torque))


def first(rig, action, since):
    """Stamp of the first report of an action after a time; waits for it."""
    number = decode.ACTIONS.index(action)

    def found():
        return [m for m in rig.since("/servo_health", since) if m.action == number]

    return decode.stamp(rig.wait_for(found, what=f"never {action}")[0])


def obey(rig, boss, angle):
    """Have the driver follow commands; from the beginning where a busy machine lets it down."""

    def follows():
        action = decode.ACTIONS[rig.last("/servo_health").action]
        boss.word = {Action.OFF: Action.HOLD, Action.RELAX: Action.OFF}.get(action, Action.PASS)
        return action is Action.PASS

    boss.angle = angle
    rig.wait_for(follows)
    reached = [np.full(4, angle)] * 2
    rig.wait_for(
        lambda: follows() and np.allclose(rig.last("/joint_states").position, reached[0], atol=0.2)
    )


@pytest.mark.parametrize(
    ("parameter", "value", "reason"),
    [
        ("joints.ids", "[5, 4, 2, 9]", "servo RR (id 9): ping: "),
        ("servo.model", 1061, "servo FL (id 5): model 1060, expected 1061"),
        ("servo.firmware_min", 46, "servo FL (id 5): firmware 45, expected 46 or newer"),
        ("bus.baud", 57600, "servo FL (id 5): ping: "),
    ],
)
def test_servos_that_are_not_those_expected_are_refused_in_one_line(
    patient, parameter, value, reason
):
    patient.wait_for(patient.bus.exists)
    before = len(patient.log_lines(DRIVER))
    patient.start(DRIVER, parameters={parameter: value})
    assert patient.exit_code(DRIVER) == 1
    told = [line for line in patient.log_lines(DRIVER)[before:] if "waiting for" not in line]
    assert len(told) == 1, told
    assert f"servos refused: {reason}" in told[0]
    assert patient.registers("torque_enable") == [0] * 4


def test_a_port_that_does_not_come_is_named(patient):
    nowhere = patient.directory / "nowhere"
    patient.start(DRIVER, parameters={"wait_for_port": 0.5, "bus.port": nowhere})
    assert patient.exit_code(DRIVER) == 1
    assert f"servos refused: {nowhere}: " in patient.log_lines(DRIVER)[-1]


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM, "exception"])
def test_however_the_driver_ends_the_legs_are_slack_and_torque_off_is_read_back(patient, end):
    broken = end == "exception"
    patient.wait_for(patient.bus.exists)
    begin = patient.now()
    patient.start(DRIVER, program=[sys.executable, "-c", BROKEN_DRIVER] if broken else ())
    patient.wait_for(lambda: patient.since("/joint_states", begin))
    boss = Boss(patient)
    boss.word, boss.angle = Action.HOLD, PULLED
    powered(patient)
    if not broken:
        obey(patient, boss, PULLED)
        patient.send(DRIVER, end)
    assert patient.exit_code(DRIVER) == int(broken)
    boss.close()
    confirmed = [line for line in patient.log_lines(DRIVER) if "torque off, confirmed" in line]
    assert confirmed
    assert patient.registers("torque_enable") == [0] * 4


def test_activation_far_from_the_command_is_no_motion(driven):
    rig, boss = driven
    obey(rig, boss, PULLED)
    boss.word = Action.OFF
    rig.slack(boss.spoken)
    off = rig.now()
    rig.wait_for(lambda: len(rig.since("/joint_states", off)) > 100)  # the tendons unwind
    before = np.array(rig.last("/joint_states").position)
    assert np.abs(PULLED - before).min() > 0.5
    boss.word = Action.HOLD
    powered(rig)
    on = rig.now()
    rig.wait_for(lambda: len(rig.since("/joint_states", on)) > 50)
    moved = (
        np.array([m.position for m in rig.since("/joint_states", on)]) - before
    ) / RAD_PER_COUNT
    assert -SAG < moved.min() <= moved.max() < 1.5
    obey(rig, boss, PULLED)


def test_deactivate_slackens_and_the_lifecycle_can_be_driven_by_hand(patient):
    patient.wait_for(patient.bus.exists)
    patient.start(DRIVER, parameters={"autostart": False})

    def change(transition):
        request = Transition(id=transition)
        return patient.call(ChangeState, f"/{DRIVER}/change_state", transition=request).success

    begin = patient.now()
    assert change(Transition.TRANSITION_CONFIGURE)
    patient.wait_for(lambda: patient.since("/joint_states", begin))
    assert change(Transition.TRANSITION_ACTIVATE)
    powered(patient)
    end = patient.now()
    assert change(Transition.TRANSITION_DEACTIVATE)
    patient.slack(end)
    assert "torque off, confirmed by every servo" in patient.log_lines(DRIVER)[-1]
    assert change(Transition.TRANSITION_CLEANUP)
    assert patient.registers("torque_enable") == [0] * 4  # the port is free
    again = patient.now()
    assert change(Transition.TRANSITION_CONFIGURE)
    patient.wait_for(lambda: patient.since("/joint_states", again))
    patient.stop(DRIVER)


def test_the_torque_service_slackens_and_brings_torque_back(driven):
    rig, _ = driven
    assert switch(rig, True) == (True, "torque on")
    assert switch(rig, True) == (False, "torque is on already")
    assert (
        rig.call(Trigger, f"/{DRIVER}/reboot_rr").message == "needs a configured driver, torque off"
    )
    off = rig.now()
    assert switch(rig, False) == (True, "slackening, then torque off")
    assert rig.slack(off).reason == "torque off, after: torque switched off by the operator"
    assert switch(rig, True) == (True, "torque on")


def test_a_zero_that_is_measured_holds_now_and_at_the_next_start(driven):
    rig, _ = driven
    answer = rig.call(Trigger, f"/{DRIVER}/zero_fl")
    assert answer.success, answer.message
    begin = rig.now()
    rig.wait_for(lambda: rig.since("/joint_states", begin))
    assert abs(rig.last("/joint_states").position[0]) < 1.5 * RAD_PER_COUNT
    written = float(answer.message.split(" at ")[1].split(" deg")[0])
    assert f"zero_deg: [{written:.2f}, 130.0, " in (rig.config / "dynamixel.yaml").read_text()
    rig.stop(DRIVER)
    again = rig.now()
    rig.start(DRIVER)
    rig.wait_for(lambda: rig.since("/joint_states", again))
    assert abs(rig.last("/joint_states").position[0]) < 1.5 * RAD_PER_COUNT


@pytest.mark.parametrize("what", ["command", "word of the supervisor"])
def test_without_commands_or_word_it_holds_after_100_ms_and_relaxes_after_500_ms(prompted, what):
    rig, boss = prompted
    obey(rig, boss, 1.0)
    if what == "command":
        boss.angle = None
        silent = boss.commanded
    else:
        boss.word = None
        silent = boss.spoken
    held = first(rig, Action.HOLD, silent)
    relaxed = first(rig, Action.RELAX, silent)
    off = decode.stamp(rig.slack(relaxed))
    assert 0.1 <= (held - silent) * 1e-9 <= 0.1 + LATE
    assert 0.5 <= (relaxed - silent) * 1e-9 <= 0.5 + LATE
    assert (off - relaxed) * 1e-9 <= 1.2 + LATE
    assert f"torque off, after: no {what} for 0.5" in rig.slack(relaxed).reason
