"""Keys, screen and command line of the operator's terminal.

URDF and Foxglove files against slot_core.robot and the messages of the graph.
"""

import graphlib
import json
import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState

from slot_bringup import operate, operate_command
from slot_bringup.operator_screen import (
    KEYS,
    QUIT,
    SILENCE,
    OperatorView,
    lines,
)
from slot_core.dynamics.servo import read_servo
from slot_core.messages import decode
from slot_core.robot import BASE_FRAME, LEGS, TENDON_JOINTS, read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Request, State
from slot_msgs.msg import (
    GaitPreview,
    MpcState,
    RobotState,
    ServoHealth,
    TendonPlan,
)

NOW = 100.0  # s, on the terminal's clock


def state(which=State.WALKING, **fields):
    message = RobotState(
        state=int(which),
        action=RobotState.ACTION_PASS,
        since=Time(sec=5),
        **fields,
    )
    message.header.stamp = Time(sec=7, nanosec=500_000_000)
    return message


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
        return SimpleNamespace(
            service_is_ready=lambda: self._ready,
            call_async=lambda _: self.called.append(name) or MagicMock(),
        )

    create_subscription = create_timer = MagicMock()


def test_every_request_of_the_supervisor_has_a_key_and_a_command():
    names = {request.name.lower() for request in Request}
    assert set(operate_command.REQUESTS) == names
    assert sorted(KEYS.values()) == sorted(names)
    assert QUIT not in KEYS


@pytest.mark.parametrize("key", [*KEYS, "a", "W", "\x1b", "\n"])
def test_a_key_calls_its_service_if_it_has_one_and_no_other(key):
    node, wanted = FakeNode(), KEYS.get(key)
    assert operate.Operator(node).press(key)
    assert node.called == ([f"supervisor/{wanted}"] if wanted else [])
    assert wanted or not node.published


def test_the_e_stop_is_published_at_once_and_until_the_supervisor_is_in_estop():
    node = FakeNode(ready=False)  # the topic works without the service
    operator = operate.Operator(node)
    operator._publish_estop()
    operator.press(" ")
    for reported in (State.WALKING, State.ESTOP):
        operator._on_state(state(reported))
        operator._publish_estop()
    assert node.published == [
        (pressed, False) for pressed in (False, True, True, False)
    ]
    # four of five messages may be lost
    assert read_supervisor().timing.estop >= 5 * operate.ESTOP_PERIOD
    operator.press("w")
    assert operator.view.answer == "walk: no supervisor answers"


def test_a_terminal_that_quits_is_not_missed_once_the_supervisor_knows():
    node = FakeNode()
    operator = operate.Operator(node)
    assert operator._estop.source != operate.Operator(node)._estop.source
    assert not operator.press(QUIT)
    left, waited = node.published
    assert left == (False, True)
    assert waited.nanoseconds == operate.LEAVE_TIME * 1e9


@pytest.mark.parametrize(
    ("name", "check", "foreign", "reason"),
    [
        (
            "joints",
            decode.joint_loads,
            JointState(name=["a", "b"]),
            "joints refused: ",
        ),
        (
            "joints",
            decode.joint_loads,
            JointState(name=TENDON_JOINTS),
            "joints refused: ",
        ),
        (
            "health",
            decode.servo_health,
            ServoHealth(action=9),
            "health refused: ",
        ),
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
    assert operator.press(QUIT)
    assert (
        operator.view.answer == "WALKING: relax first (x), or stop with Ctrl-C"
    )
    idle = state(State.IDLE)
    idle.action = RobotState.ACTION_OFF
    operator._on_state(idle)
    assert not operator.press(QUIT)
    assert not operate.Operator(FakeNode()).press(QUIT)  # without a supervisor


def test_the_screen_shows_state_warnings_problems_gait_and_what_is_wrong_with_a_servo():
    """The supervisor's own problem is above, with its state."""
    operator, warnings = (
        operate.Operator(FakeNode()),
        ["node mpc_controller is silent"],
    )
    for name in ("controller", "servo bus", "supervisor"):
        status = DiagnosticStatus(name=name, level=b"\x01", message="late")
        operator._on_diagnostics(DiagnosticArray(status=[status]))
    effort = [
        0.5 * float(read_servo().tendon_stall(11.9))
    ] * 4  # at this voltage
    view = operator.view
    view.state, view.state_time = (
        state(reason="as asked", warnings=warnings),
        NOW,
    )
    view.joints = JointState(
        name=TENDON_JOINTS, position=[0.5] * 4, effort=effort
    )
    view.health = ServoHealth(
        action=RobotState.ACTION_PASS,
        hardware_error=[0, 0, 0x20, 0],
        torque=[True, True, False, True],
        voltage=[11.9] * 4,
    )
    velocity, pose = [0.04, 0.0, -0.1], [0.06, 0.0, 0.1]
    view.preview = GaitPreview(gait="walk", velocity=velocity, pose=pose)
    shown = lines(view, NOW)
    assert shown[:2] == ["WALKING for 2.5 s: as asked", f"  ! {warnings[0]}"]
    assert shown[3].startswith(
        "walk     +0.040 +0.000 m/s  -5.7 deg/s   height 60 mm"
    )
    legs = {line[:2]: line.split() for line in shown if line[:2] in LEGS}
    sound = ["50", "on", "none"]  # % of the stall torque
    assert {leg: [words[3], *words[-2:]] for leg, words in legs.items()} == {
        "FL": sound,
        "FR": sound,
        "RL": ["50", "off", "overload"],
        "RR": sound,
    }
    problems = [line[4:] for line in shown if "late" in line]
    assert problems == ["controller: late", "servo bus: late"]


def test_a_narrow_terminal_shows_the_whole_reason(monkeypatch, capsys):
    monkeypatch.setattr(
        operate.shutil, "get_terminal_size", lambda: os.terminal_size((60, 40))
    )
    reason = "slack after: held 4 times in 20 s, limit 3, " + 9 * "the cause "
    view = OperatorView(state=state(State.FAULT, reason=reason))
    view.state_time = operate.time.monotonic()
    operate._draw(view)
    shown = re.sub("\x1b\\[[0-9;]*[HJKm]", "", capsys.readouterr().out)
    assert shown.replace("\n", " ").startswith(f"FAULT for 2.5 s: {reason}")


@pytest.mark.parametrize("which", State)
def test_the_first_line_is_red_in_relax_estop_and_fault_and_without_a_present_state(
    which,
):
    view = OperatorView(state=state(which), state_time=NOW)
    assert view.alarming(NOW) == (
        which in (State.RELAX, State.ESTOP, State.FAULT)
    )
    later = NOW + SILENCE + 0.1
    assert view.alarming(later)
    shown = lines(view, later)
    assert shown[0].startswith("NO STATE from the supervisor for 0.6 s")
    assert not any(which.name in line for line in shown[1:])


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
    wanted = operate.service(
        operate_command._parser().parse_args(arguments.split())
    )
    assert wanted.name == name
    assert {field: getattr(wanted.request, field) for field in fields} == fields


@pytest.mark.parametrize(
    ("arguments", "who"),
    [
        (["state"], "supervisor"),
        (["zero", "FL"], "driver of servos"),
        (["inject", "silent"], "simulated robot"),
        ([], ""),
    ],
)
def test_without_a_graph_or_a_terminal_one_line_says_so(
    arguments, who, capsys, monkeypatch
):
    monkeypatch.setattr(operate, "SEARCH_TIME", 0.2)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: False))
    assert operate_command.main(arguments) == 1
    place = f"ROS domain {os.environ['ROS_DOMAIN_ID']}, namespace /"
    message = (
        "the live display needs a terminal; `scripts/operate state` does not"
    )
    if who:
        message = (
            f"no {who} answers in {place} within 0.2 s: does scripts/run run?"
        )
    assert capsys.readouterr().err == f"scripts/operate: {message}\n"


SHARE = Path(__file__).parents[2] / "slot_bringup"
URDF = ET.parse(SHARE / "urdf/slot.urdf").getroot()
MESSAGES = {
    "mpc_state": MpcState,
    "tendon_plan": TendonPlan,
    "desired_joint_angles": JointState,
}
ROBOT = read_robot()


TORSO = "link[@name='torso_link']"


def tabled():
    """Path of an element, its attribute, and the robot's number for it."""
    for kind in ("visual", "collision"):
        yield f"{TORSO}/{kind}/geometry/box", "size", ROBOT.torso.size
    yield f"{TORSO}/inertial/mass", "value", ROBOT.torso.mass
    for i, j in zip(*np.triu_indices(3)):
        axes = "xyz"[i] + "xyz"[j]
        yield f"{TORSO}/inertial/inertia", f"i{axes}", ROBOT.torso.inertia[i, j]
    servo, volts = read_servo(), read_servo().nominal_voltage
    for k, leg in enumerate(LEGS):
        clamp = f"joint[@name='{leg}_clamp']/origin"
        x, y, _ = ROBOT.outward[k]
        yield clamp, "xyz", ROBOT.clamps[k]
        yield clamp, "rpy", [0.0, 0.0, np.arctan2(y, x)]
        limits = {
            "lower": 0.0,
            "upper": ROBOT.tendon.angle_max,
            "effort": servo.tendon_stall(volts),
            "velocity": servo.tendon_speed(volts),
        }
        for name, limit in limits.items():
            yield f"joint[@name='{TENDON_JOINTS[k]}']/limit", name, limit
        spool = f"link[@name='{leg}_spool_link']/visual/geometry/cylinder"
        yield spool, "radius", ROBOT.tendon.spool_radius
        yield spool, "length", ROBOT.leg.width


@pytest.mark.parametrize(("path", "attribute", "expected"), [*tabled()])
def test_a_number_is_that_of_the_robot(path, attribute, expected):
    # the URDF is written with six digits
    np.testing.assert_allclose(
        numbers(URDF, path, attribute), expected, rtol=1e-5, atol=1e-9
    )


def numbers(element, path, attribute):
    return np.array(element.find(path).get(attribute).split(), dtype=float)


def test_links_form_one_tree_rooted_in_the_base_frame():
    links = [element.get("name") for element in URDF.iter("link")]
    joints = URDF.findall("joint")
    parents = {
        j.find("child").get("link"): [j.find("parent").get("link")]
        for j in joints
    }
    assert len(links) == len(set(links)) == 2 + 2 * len(LEGS)
    assert sorted([BASE_FRAME, *parents]) == sorted(links)
    order = graphlib.TopologicalSorter(parents).static_order()
    assert next(order) == BASE_FRAME  # and there is no circle
    assert [*URDF.find("link")] == []  # KDL accepts no inertia on the root link


@pytest.mark.parametrize("leg", LEGS)
def test_a_spool_turns_about_its_drum_at_the_clamp_of_its_leg(leg):
    names = f"{leg}_clamp", f"{leg}_tendon"
    clamp, tendon = (URDF.find(f"joint[@name='{name}']") for name in names)
    assert (clamp.get("type"), tendon.get("type")) == ("fixed", "revolute")
    ends = [
        joint.find(end).get("link")
        for joint in (clamp, tendon)
        for end in ("child", "parent")
    ]
    link, spool = f"leg_{leg}_link", f"{leg}_spool_link"
    assert ends == [link, BASE_FRAME, spool, link]
    assert tendon.find("origin") is None
    # about fixed axes
    rpy = numbers(URDF.find(f"link[@name='{spool}']"), "visual/origin", "rpy")
    drum = Rotation.from_euler("xyz", rpy).apply([0, 0, 1])
    np.testing.assert_allclose(
        np.abs(drum @ numbers(tendon, "axis", "xyz")), 1.0
    )


def test_plots_name_fields_that_the_messages_have():
    """Of Foxglove's layout."""
    layout = json.loads((SHARE / "foxglove/slot.json").read_text())[
        "configById"
    ]
    plots = [plot for name, plot in layout.items() if name.startswith("Plot!")]
    values = [path["value"] for plot in plots for path in plot["paths"]]
    assert len(values) == len(set(values)) == 11
    for value in values:
        topic, field, index = re.match(
            r"/(\w+)\.(\w+)(?:\[(\d+)\])?", value
        ).groups()
        kind = MESSAGES[topic].get_fields_and_field_types()[field]
        length = re.search(r"\[(\d*)\]|sequence", kind)
        assert (index is None) == (length is None), value
        if length and length[1]:
            assert int(index) < int(length[1]), value
