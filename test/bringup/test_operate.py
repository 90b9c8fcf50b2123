"""Keys, screen and command line of the operator's terminal."""

import os
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState

from slot_bringup import operate, operate_command, operator_keys
from slot_bringup.operator_screen import SILENCE, Motion, OperatorView, lines
from slot_core.dynamics.servo import read_servo
from slot_core.messages import decode
from slot_core.robot import LEGS, TENDON_JOINTS
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Request, State
from slot_msgs.msg import GaitPreview, RobotState, ServoHealth

NOW = 100.0  # s, on the terminal's clock


def state(which=State.WALKING, **fields):
    message = RobotState(
        state=int(which), action=RobotState.ACTION_PASS, since=Time(sec=5), **fields
    )
    message.header.stamp = Time(sec=7, nanosec=500_000_000)
    return message


def health(**fields):
    sound = {
        "action": RobotState.ACTION_PASS,
        "torque": [True] * 4,
        "silence": [0.01] * 4,
        "temperature": [31.0, 32.0, 33.0, 34.0],
        "voltage": [11.9] * 4,
    }
    return ServoHealth(**sound | fields)


def screen(**parts):
    return lines(OperatorView(**{"state": state(), "state_time": NOW} | parts), NOW)


class FakeNode:
    """Node that records published messages and service calls."""

    def __init__(self, ready=True):
        self.published, self.called, self._ready = [], [], ready

    def create_publisher(self, *_):
        return SimpleNamespace(
            publish=lambda m: self.published.append((m.pressed, m.leaving)),
            wait_for_all_acked=self.published.append,
        )

    def create_client(self, _, name):
        def call(request):
            self.called.append(name)
            return MagicMock()

        return SimpleNamespace(service_is_ready=lambda: self._ready, call_async=call)

    create_subscription = create_timer = MagicMock()


def test_every_request_of_the_supervisor_has_a_key_and_a_command():
    names = {request.name.lower() for request in Request}
    assert set(operator_keys.REQUESTS) == names
    assert sorted(operator_keys.KEYS.values()) == sorted(names)
    assert operator_keys.QUIT not in operator_keys.KEYS


@pytest.mark.parametrize("key", [*operator_keys.KEYS, "a", "W", "\x1b", "\n"])
def test_a_key_calls_its_service_if_it_has_one_and_no_other(key):
    node = FakeNode()
    assert operate.Operator(node).press(key)
    wanted = operator_keys.KEYS.get(key)
    assert node.called == ([f"supervisor/{wanted}"] if wanted else [])
    assert wanted or not node.published


def test_the_e_stop_is_published_at_once_and_until_the_supervisor_is_in_estop():
    node = FakeNode(ready=False)  # the topic works without the service
    operator = operate.Operator(node)
    operator._publish_estop()
    operator.press(" ")
    operator._on_state(state(State.WALKING))
    operator._publish_estop()
    operator._on_state(state(State.ESTOP))
    operator._publish_estop()
    assert node.published == [
        (pressed, False) for pressed in (False, True, True, False)
    ]


def test_a_terminal_that_quits_is_not_missed_once_the_supervisor_knows():
    node = FakeNode()
    operator = operate.Operator(node)
    assert operator._estop.source != operate.Operator(node)._estop.source
    assert not operator.press(operator_keys.QUIT)
    left, waited = node.published
    assert left == (False, True)
    assert waited.nanoseconds == operate.LEAVE_TIME * 1e9


def test_four_of_five_e_stop_messages_may_be_lost():
    assert read_supervisor().timing.estop >= 5 * operate.ESTOP_PERIOD


def test_a_request_without_a_supervisor_is_refused_at_once():
    operator = operate.Operator(FakeNode(ready=False))
    operator.press("w")
    assert operator.view.answer == "walk: no supervisor answers"


@pytest.mark.parametrize(
    ("name", "check", "foreign", "reason"),
    [
        ("joints", decode.joint_loads, JointState(name=["a", "b"]), "joints refused: "),
        (
            "joints",
            decode.joint_loads,
            JointState(name=TENDON_JOINTS),
            "joints refused: ",
        ),
        ("health", decode.servo_health, ServoHealth(action=9), "health refused: "),
    ],
)
def test_a_foreign_message_is_named_and_does_not_end_the_e_stops_source(
    name, check, foreign, reason
):
    operator = operate.Operator(FakeNode())
    assert not operator._show(name, check, foreign)
    assert operator.view.answer.startswith(reason)
    operator._on_state(RobotState(state=99))
    assert operator.view.answer.startswith("state refused: ")
    assert lines(operator.view, NOW)


def test_quitting_is_refused_under_torque():
    operator = operate.Operator(FakeNode())
    operator._on_state(state(State.WALKING))
    assert operator.press(operator_keys.QUIT)
    assert operator.view.answer == "WALKING: relax first (x), or stop with Ctrl-C"
    idle = state(State.IDLE)
    idle.action = RobotState.ACTION_OFF
    operator._on_state(idle)
    assert not operator.press(operator_keys.QUIT)
    assert not operate.Operator(FakeNode()).press(
        operator_keys.QUIT
    )  # without a supervisor


def test_the_screen_shows_state_warnings_and_what_is_wrong_with_a_servo():
    message = state(
        reason="walk requested", warnings=["node mpc_controller silent for 1 s"]
    )
    broken = health(hardware_error=[0, 0, 0x20, 0], torque=[True, True, False, True])
    stall = float(read_servo().tendon_stall(11.9))  # at the voltage of `health`
    effort = [0.5 * stall] * 4
    angles = JointState(name=TENDON_JOINTS, position=[0.5] * 4, effort=effort)
    shown = screen(state=message, health=broken, joints=angles)
    assert shown[:2] == [
        "WALKING for 2.5 s: walk requested",
        "  ! node mpc_controller silent for 1 s",
    ]
    legs = {line[:2]: line.split() for line in shown if line[:2] in LEGS}
    assert {leg: words[-2:] for leg, words in legs.items()} == {
        "FL": ["on", "none"],
        "FR": ["on", "none"],
        "RL": ["off", "overload"],
        "RR": ["on", "none"],
    }
    assert {words[3] for words in legs.values()} == {"50"}  # %, of the stall torque


def test_problems_of_every_reporter_stay_on_the_screen():
    """The supervisor's own is above, with its state."""
    operator = operate.Operator(FakeNode())
    for name in ("controller", "servo bus", "supervisor"):
        status = DiagnosticStatus(name=name, level=b"\x01", message="late")
        operator._on_diagnostics(DiagnosticArray(status=[status]))
    shown = screen(health=health(), diagnostics=operator.view.diagnostics)
    assert [line[4:] for line in shown if "late" in line] == [
        "controller: late",
        "servo bus: late",
    ]


def test_velocity_commanded_and_measured_place_and_pace_are_shown():
    motion, now = Motion(), NOW + 5.9
    for k in range(60):
        torso = np.array([0.0, 0.0, 0.0, 0.0015 * k, 0.0, 0.0612, *np.zeros(6)])
        motion.add(NOW + 0.1 * k, 0.05 * k, torso)  # at half of real time
    preview = GaitPreview(
        gait="walk", velocity=[0.04, 0.0, -0.1], pose=[0.06, 0.0, 0.1]
    )
    shown = lines(OperatorView(state(), now, preview=preview, motion=motion), now)
    assert shown[2:4] == [
        "walk     +0.040 +0.000 m/s  -5.7 deg/s   height 60 mm   roll +0.0   pitch +5.7 deg",
        "reached  +0.030 +0.000 m/s  +0.0 deg/s   real-time factor 0.50",
    ]
    assert shown[4].startswith("x +0.088   y +0.000 m   z 61 mm")


def test_what_is_not_known_is_a_dash():
    shown = screen()
    assert shown[2:4] == ["no gait yet", "no state of the torso yet"]
    (leg,) = [line for line in shown if line.startswith("FL")]
    assert leg.split() == ["FL", "-", "-", "-", "0.0"]


def test_an_outdated_state_is_not_shown():
    shown = screen(state_time=NOW - SILENCE - 0.1)
    assert shown[0].startswith("NO STATE from the supervisor for 0.6 s")
    assert not any("WALKING" in line for line in shown)


@pytest.mark.parametrize("which", State)
def test_the_first_line_is_red_in_relax_estop_and_fault_and_without_a_present_state(
    which,
):
    alarming = which in (State.RELAX, State.ESTOP, State.FAULT)
    assert OperatorView(state=state(which), state_time=NOW).alarming(NOW) == alarming
    assert OperatorView(state=state(which), state_time=NOW - 1.0).alarming(NOW)


@pytest.mark.parametrize(
    ("arguments", "name", "fields"),
    [
        ("ready", "supervisor/ready", {}),
        ("estop", "supervisor/estop", {}),
        ("reboot RL", "dynamixel_driver/reboot_rl", {}),
        ("zero FR", "dynamixel_driver/zero_fr", {}),
        ("forget robot-7f3a", "supervisor/forget", {"source": "robot-7f3a"}),
        ("inject silent", "sim_robot/inject", {"kind": "silent", "leg": "all"}),
        (
            "inject late RR --value 0.02 --duration 3 --clear",
            "sim_robot/inject",
            {"leg": "RR", "value": 0.02, "duration": 3.0, "clear": True},
        ),
    ],
)
def test_an_action_calls_the_service_of_its_node(arguments, name, fields):
    options = operate_command._parser().parse_args(arguments.split())
    wanted = operate.service(options)
    assert wanted.name == name
    assert {field: getattr(wanted.request, field) for field in fields} == fields


def test_the_live_display_without_a_terminal_is_refused_in_one_line(
    capsys, monkeypatch
):
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: False))
    assert operate_command.main([]) == 1
    message = "the live display needs a terminal, scripts/operate state none"
    assert capsys.readouterr().err == f"scripts/operate: {message}\n"


@pytest.mark.parametrize(
    ("arguments", "who"),
    [
        (["state"], "supervisor"),
        (["zero", "FL"], "driver of servos"),
        (["inject", "silent"], "simulated robot"),
    ],
)
def test_without_a_graph_one_line_names_the_missing_node(
    arguments, who, capsys, monkeypatch
):
    monkeypatch.setattr(operate, "SEARCH_TIME", 0.2)
    assert operate_command.main(arguments) == 1
    place = f"ROS domain {os.environ['ROS_DOMAIN_ID']}, namespace /"
    message = f"no {who} answers in {place} within 0.2 s: does scripts/run run?"
    assert capsys.readouterr().err == f"scripts/operate: {message}\n"
