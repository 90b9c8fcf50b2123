"""The page of a running graph: what its controls send, and what it says of the messages."""

from types import SimpleNamespace

import numpy as np
import pytest
from std_srvs.srv import Trigger

from slot_bringup.playing.graph_page import GraphPage
from slot_bringup.playing.graph_robot import TRIES, WAIT, GraphRobot
from slot_bringup.playing.main_page import start_server
from slot_core.config import ConfigError
from slot_core.messages import decode
from slot_core.safety.states import LATCHED, Request, State
from slot_msgs.msg import GaitPreview, RobotState

VELOCITY = np.array([0.03, 0.0, 0.0])


class Graph:
    """Node of a graph whose services grant what is asked, but `refused`."""

    def __init__(self):
        self.refused, self.silent = {}, False
        self.called, self.published, self.inputs = [], [], {}

    def create_client(self, kind, name):
        def call_async(request):
            self.called.append((name, request))
            why = self.refused.get(name, "")
            result = SimpleNamespace(success=not why, message=why)
            answer = SimpleNamespace(result=lambda: result)
            return SimpleNamespace(add_done_callback=lambda done: done(answer))

        return SimpleNamespace(
            service_is_ready=lambda: not self.silent, call_async=call_async
        )

    def create_publisher(self, kind, topic, _):
        return SimpleNamespace(
            publish=lambda message: self.published.append((topic, message))
        )

    def create_subscription(self, kind, topic, take, _):
        self.inputs[topic] = take

    def get_subscriptions_info_by_topic(self, topic):
        return [SimpleNamespace(topic_type="geometry_msgs/msg/TwistStamped")]

    def report(self, state, reason=""):
        self.inputs["robot_state"](RobotState(state=state.value, reason=reason))

    def preview(self):
        ones, three = [1.0] * 4, [0.0] * 3
        message = GaitPreview(
            requested="walk",
            stages=1,
            reference=[0.0] * 12,
            contact=[True] * 4,
            velocity_ahead=three,
            friction=ones,
            normal_force=ones,
            tendon_angle=ones,
            pose=[0.06, 0.0, 0.0],
        )
        self.inputs["gait_preview"](message)

    @property
    def names(self):
        return [name for name, _ in self.called]


@pytest.fixture
def graph():
    return Graph()


@pytest.fixture
def robot(graph):
    return GraphRobot(graph)


def pass_through(graph, robot, *states):
    for state in states:
        for _ in range(2):  # the supervisor repeats its state
            graph.report(state)
            robot.frame()


def test_a_gait_is_set_and_the_supervisor_asked_once_in_every_state_on_the_way(
    graph, robot
):
    robot.set_gait("walk")
    pass_through(
        graph, robot, State.READY, State.STANDING, State.WALKING, State.STANDING
    )
    assert graph.names == ["set_gait", "supervisor/stand", "supervisor/walk"]
    assert graph.called[0][1].gait == "walk"


def test_to_walk_does_not_raise_a_robot_that_lies_and_to_stand_up_does(graph, robot):
    robot.set_gait("walk")
    pass_through(graph, robot, State.IDLE)
    assert graph.names == ["set_gait"]
    robot.stand_up()
    pass_through(graph, robot, State.IDLE, State.READY, State.STANDING, State.STANDING)
    assert graph.names[1:] == ["supervisor/ready", "supervisor/stand"]


@pytest.mark.parametrize("state", LATCHED)
def test_in_an_emergency_stop_and_a_fault_standing_up_is_refused(graph, robot, state):
    pass_through(graph, robot, state)
    with pytest.raises(
        ConfigError, match=f"STAND refused in {state.name}: reset first"
    ):
        robot.stand_up()
    pass_through(graph, robot, state, State.IDLE, State.READY)
    assert not graph.names


@pytest.mark.parametrize("state", LATCHED)
def test_an_emergency_stop_or_a_fault_on_the_way_ends_it(graph, robot, state):
    robot.stand_up()
    pass_through(graph, robot, State.IDLE, state, State.IDLE, State.READY)
    assert graph.names == ["supervisor/ready"]


def test_a_request_that_is_refused_is_tried_again_for_a_while_and_is_said(graph, robot):
    """A robot that has just got torque has no estimate yet."""
    graph.refused = {"supervisor/stand": "STAND refused in READY: no estimate"}
    robot.set_gait("walk")
    pass_through(graph, robot, *[State.READY] * WAIT)
    assert graph.names == ["set_gait", *["supervisor/stand"] * 2]
    graph.refused = {"supervisor/walk": "WALK refused in STANDING: no estimate"}
    pass_through(graph, robot, *[State.READY] * WAIT, *[State.STANDING] * TRIES * WAIT)
    assert graph.names[3:] == ["supervisor/stand", *["supervisor/walk"] * TRIES]
    pass_through(graph, robot, State.READY)
    assert graph.names[3:] == ["supervisor/stand", *["supervisor/walk"] * TRIES]
    assert robot.said == "WALK refused in STANDING: no estimate"


@pytest.mark.parametrize("request_", Request)
def test_a_request_is_made_at_once_and_ends_the_way(graph, robot, request_):
    robot.stand_up()
    robot.request(request_)
    pass_through(graph, robot, State.IDLE)
    ((name, message),) = graph.called
    assert name == f"supervisor/{request_.name.lower()}"
    assert isinstance(message, Trigger.Request)


def test_velocity_is_repeated_and_pose_sent_once_a_gait_is_known(graph, robot):
    for command in (lambda: robot.set_velocity(VELOCITY), lambda: robot.set_pose(None)):
        with pytest.raises(ConfigError, match="no gait_scheduler answers"):
            command()
    graph.preview()
    robot.frame()
    robot.set_velocity(VELOCITY)
    pass_through(graph, robot, State.WALKING)
    robot.set_pose(np.array([0.06, 0.0, 0.02]))
    topics = [topic for topic, _ in graph.published]
    assert topics == ["cmd_vel", "cmd_vel", "body_pose"]
    robot.set_pose(None)
    assert graph.called[-1][1].gait == "walk"


def test_a_graph_that_does_not_answer_is_named(graph, robot):
    graph.silent = True
    robot.inject("tendon_broken", "FL", 0.0, 0.0, clear=False)
    assert robot.said == "sim_robot/inject: nothing answers"
    assert not graph.called


def test_the_present_gait_is_that_of_the_graph(graph, robot):
    graph.report(State.WALKING)
    assert robot.found()
    assert not robot.walks()
    assert robot.gait == "stand"
    graph.preview()
    assert robot.walks()
    assert robot.gait == "walk"


@pytest.fixture
def page(robot):
    server = start_server("127.0.0.1", 0, "")
    yield GraphPage(server, robot)
    server.stop()


def control(page, label):
    handles = page.server.gui._gui_input_handle_from_uuid.values()
    return next(handle for handle in handles if getattr(handle, "label", "") == label)


def run(page, seconds=0.2):
    now = [0.0]
    page.run(
        lambda: now[0] > seconds,
        lambda wait: now.__setitem__(0, now[0] + wait + 1e-3),
        lambda: now[0],
    )


def test_the_controls_of_the_page_reach_the_graph(graph, page):
    graph.preview()
    run(page)
    control(page, "gait").value = "walk"
    control(page, "v_x (m/s)").value = 0.03
    control(page, "kind").value = "tendon_slack"
    control(page, "leg").value = "RR"
    control(page, "value").value = 0.002
    graph.report(State.STANDING)
    run(page)
    graph.report(State.WALKING)
    run(page)
    assert graph.names == ["set_gait", "supervisor/walk"]
    assert decode.velocity(graph.published[-1][1])[1][0] == pytest.approx(0.03)
    control(page, "fault").value = "inject"
    run(page)
    name, fault = graph.called[-1]
    assert name == "sim_robot/inject"
    assert (fault.kind, fault.leg, fault.value, fault.clear) == (
        "tendon_slack",
        "RR",
        0.002,
        False,
    )


def test_after_an_emergency_stop_only_the_reset_resets_and_standing_up_does_not_walk(
    graph, page
):
    def press(label, value, *states):
        before = len(graph.called)
        control(page, label).value = value
        for state in states:
            graph.report(state)
            run(page)
        return [name.removeprefix("supervisor/") for name in graph.names[before:]]

    graph.preview()
    press("gait", "walk", State.WALKING)
    assert press("operator", "e-stop", State.ESTOP) == ["estop"]
    for label, value in (
        ("v_x (m/s)", -0.01),
        ("height (mm)", 50.0),
        ("gait", "crawl"),
    ):
        assert {"reset", "ready"}.isdisjoint(press(label, value, State.ESTOP))
    press("operator", "stand up", State.ESTOP)
    assert "STAND refused in ESTOP: reset first" in page._text.content
    assert press("operator", "relax", State.ESTOP) == ["relax"]
    reset = "after a stop", "reset e-stop or fault"
    assert press(*reset, State.ESTOP, State.IDLE) == ["reset"]
    press("gait", "walk")
    rise = State.IDLE, State.READY, State.STANDING, State.STANDING
    assert press("operator", "stand up", *rise)[-2:] == ["ready", "stand"]
    assert control(page, "gait").value == "stand"
    assert press("gait", "walk", State.STANDING) == ["set_gait", "walk"]


def test_the_page_says_what_the_supervisor_says_and_which_message_is_refused(
    graph, page
):
    graph.report(State.HOLD, "slack or broken <tendon> FL")
    run(page)
    assert "<b>HOLD</b> slack or broken &lt;tendon&gt; FL" in page._text.content
    graph.inputs["gait_preview"](GaitPreview(stages=3))
    run(page)
    assert "a message is refused: " in page._text.content


def test_a_graph_that_is_silent_is_named_and_its_last_state_is_not_said_any_more(
    graph, page
):
    graph.report(State.WALKING, "as asked")
    run(page, 1.0)
    assert "WALKING" in page._text.content
    run(page, 4.0)
    assert (
        "<b>no state for 4 s: the graph has ended, or hangs</b>" in page._text.content
    )
    assert "WALKING" not in page._text.content
    graph.report(State.STANDING)
    run(page, 1.0)
    assert "STANDING" in page._text.content
    assert "no state" not in page._text.content
