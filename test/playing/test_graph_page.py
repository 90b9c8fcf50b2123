"""The page of a running graph: what its controls send, and what it says of the messages.

Bag of a played robot: the checks of a recorded walk hold for it.

Access to the page of scripts/play: this machine alone, or whoever has the token.
"""

import urllib.error
import urllib.request
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import psutil
import pytest
from std_srvs.srv import Trigger
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from slot_bringup.operator_screen import KEYS
from slot_bringup.playing import play_page
from slot_bringup.playing.controls import RED
from slot_bringup.playing.graph_page import GraphPage
from slot_bringup.playing.graph_robot import TRIES, WAIT, GraphRobot
from slot_bringup.playing.main_page import main
from slot_bringup.playing.page_server import (
    COOKIE,
    Access,
    is_this_machine,
    start_server,
)
from slot_core.config import ConfigError
from slot_core.messages import decode
from slot_core.safety.states import LATCHED, Request, State
from slot_lab.bags.bag import Bag
from slot_lab.bags.check_bag import check_bag
from slot_lab.play.played_robot import PlayedRobot
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
            answer = Mock(
                **{"result.return_value": Mock(success=not why, message=why)}
            )
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
def robot():
    return GraphRobot(Graph())


@pytest.fixture
def graph(robot):
    return robot._node


def pass_through(graph, robot, *states):
    for state in states:
        for _ in range(2):  # the supervisor repeats its state
            graph.report(state)
            robot.frame()


def test_a_gait_asks_once_in_every_state_on_the_way_and_rising_is_asked_for_apart(
    graph, robot
):
    robot.set_gait("walk")
    way = State.READY, State.STANDING, State.WALKING, State.STANDING
    pass_through(graph, robot, *way)
    assert graph.names == ["set_gait", "supervisor/stand", "supervisor/walk"]
    assert graph.called[0][1].gait == "walk"
    robot.set_gait("walk")
    pass_through(graph, robot, State.IDLE)
    robot.stand_up()
    pass_through(
        graph, robot, State.IDLE, State.READY, State.STANDING, State.STANDING
    )
    assert graph.names[3:] == [
        "set_gait",
        "supervisor/ready",
        "supervisor/stand",
    ]


@pytest.mark.parametrize("state", LATCHED)
def test_in_an_emergency_stop_and_a_fault_standing_up_is_refused_or_ends(
    graph, robot, state
):
    robot.stand_up()
    pass_through(graph, robot, State.IDLE, state, State.IDLE, State.READY)
    assert graph.names == ["supervisor/ready"]
    pass_through(graph, robot, state)
    with pytest.raises(
        ConfigError, match=f"STAND refused in {state.name}: reset first"
    ):
        robot.stand_up()
    pass_through(graph, robot, state, State.IDLE, State.READY)
    assert graph.names == ["supervisor/ready"]


def test_a_request_that_is_refused_is_tried_again_for_a_while_and_is_said(
    graph, robot
):
    """A robot that has just got torque has no estimate yet."""
    line = "WALK refused in STANDING: no estimate"
    graph.refused = {"supervisor/walk": line}
    robot.set_gait("walk")
    pass_through(graph, robot, State.READY, *[State.STANDING] * TRIES * WAIT)
    asked = ["set_gait", "supervisor/stand", *["supervisor/walk"] * TRIES]
    assert graph.names == asked
    pass_through(graph, robot, State.READY)
    assert graph.names == asked
    assert robot.said == line


@pytest.mark.parametrize("request_", Request)
def test_a_request_is_made_at_once_and_ends_the_way(graph, robot, request_):
    robot.stand_up()
    robot.request(request_)
    pass_through(graph, robot, State.IDLE)
    ((name, message),) = graph.called
    assert name == f"supervisor/{request_.name.lower()}"
    assert isinstance(message, Trigger.Request)


def test_velocity_is_repeated_and_pose_sent_once_a_gait_is_known(graph, robot):
    for command in (
        lambda: robot.set_velocity(VELOCITY),
        lambda: robot.set_pose(None),
    ):
        with pytest.raises(ConfigError, match="no gait_scheduler answers"):
            command()
    assert not robot.walks()
    assert robot.gait == "stand"
    graph.preview()
    assert robot.walks()
    assert robot.gait == "walk"
    robot.frame()
    robot.set_velocity(VELOCITY)
    pass_through(graph, robot, State.WALKING)
    robot.set_pose(np.array([0.06, 0.0, 0.02]))
    topics = [topic for topic, _ in graph.published]
    assert topics == ["cmd_vel", "cmd_vel", "body_pose"]
    robot.set_pose(None)
    assert graph.called[-1][1].gait == "walk"
    graph.silent = True
    robot.inject("tendon_broken", "FL", 0.0, 0.0, clear=False)
    assert robot.said == "sim_robot/inject: nothing answers"


@pytest.fixture
def page(robot):
    server = start_server("127.0.0.1", 0, "")
    yield GraphPage(server, robot)
    server.stop()


def control(page, label):
    handles = page.server.gui._gui_input_handle_from_uuid.values()
    return next(
        handle for handle in handles if getattr(handle, "label", "") == label
    )


def run(page, seconds=0.2):
    now = [0.0]
    page.run(
        lambda: now[0] > seconds,
        lambda wait: now.__setitem__(0, now[0] + wait + 1e-3),
        lambda: now[0],
    )


@pytest.mark.parametrize(
    ("label", "value", "reached"),
    [
        ("gait", "walk", lambda g: g.called[0][1].gait == "walk"),
        (
            "v_x (m/s)",
            0.03,
            lambda g: decode.velocity(g.published[-1][1])[1][0] == 0.03,
        ),
        (
            "fault",
            "clear",
            lambda g: g.names == ["sim_robot/inject"] and g.called[0][1].clear,
        ),
    ],
)
def test_a_control_of_the_page_reaches_the_graph(
    graph, page, label, value, reached
):
    graph.preview()
    run(page)
    control(page, label).value = value
    for _ in range(2):
        run(page)
        graph.report(State.WALKING)
    assert reached(graph)


def test_after_an_emergency_stop_only_the_reset_resets_and_standing_up_does_not_walk(
    graph, page
):
    def press(label, value, *states):
        before = len(graph.called)
        control(page, label).value = value
        for state in states:
            graph.report(state)
            run(page)
        return [
            name.removeprefix("supervisor/") for name in graph.names[before:]
        ]

    graph.preview()
    press("gait", "walk", State.WALKING)
    assert press("E-STOP (SPACE)", True, State.ESTOP) == ["estop"]
    moves = {"v_x (m/s)": -0.01, "height (mm)": 50.0, "gait": "crawl"}
    for label, value in moves.items():
        assert {"reset", "ready"}.isdisjoint(press(label, value, State.ESTOP))
    press("operator", "stand up (S)", State.ESTOP)
    assert "STAND refused in ESTOP: reset first" in page._text.content
    assert press("operator", "relax (X)", State.ESTOP) == ["relax"]
    reset = "after a stop", "reset e-stop or fault (Shift+R)"
    assert press(*reset, State.ESTOP, State.IDLE) == ["reset"]
    press("gait", "walk")
    rise = State.IDLE, State.READY, State.STANDING, State.STANDING
    assert press("operator", "stand up (S)", *rise)[-2:] == ["ready", "stand"]
    assert control(page, "gait").value == "stand"
    assert press("gait", "walk", State.STANDING) == ["set_gait", "walk"]


def test_the_e_stop_is_at_the_top_and_red_and_every_key_that_is_bound_is_listed(
    graph, page
):
    """A key of the terminal makes the same request on the page."""
    gui = page.server.gui
    containers = gui._container_handle_from_uuid
    top = min(containers["root"]._children.values(), key=lambda c: c.order)
    assert (top.label, top.color) == ("E-STOP (SPACE)", RED)
    texts = (
        getattr(child, "content", "")
        for container in containers.values()
        for child in container._children.values()
    )
    (listed,) = (text for text in texts if "<kbd>" in text)
    commands = gui._command_handle_from_uuid.values()
    assert listed.count("<tr>") == len(commands)
    for command in commands:
        assert f"<td>{command.label}</td>" in listed
    bound = {(c.hotkey, c.modifier): c._impl.trigger_cb for c in commands}
    assert {("W", None), ("S", None)} < set(bound)
    for key in ("space", None), ("X", None), ("R", "shift"):
        bound[key][0](None)
    run(page)
    asked = [f"supervisor/{KEYS[key]}" for key in " xR"]
    assert graph.names == asked


def test_the_page_says_state_silence_and_which_message_is_refused(graph, page):
    def said(seconds=0.2):
        run(page, seconds)
        return page._text.content

    graph.report(State.HOLD, "slack or broken <tendon> FL")
    reason = "until the reason is gone: slack or broken &lt;tendon&gt; FL"
    assert reason in said()
    graph.inputs["gait_preview"](GaitPreview(stages=3))
    assert "a message is refused: " in said()
    silent = said(4.0)
    assert "<b>no state for 4 s: the graph has ended, or hangs</b>" in silent
    assert "HOLD" not in silent
    graph.report(State.STANDING)
    assert "no state" not in said(1.0)


def test_a_saved_bag_replays_equal_to_the_last_bit_though_the_world_has_changed(
    tmp_path,
):
    robot = PlayedRobot()
    robot.wishes.gait, robot.wishes.velocity = (
        "walk",
        np.array([0.05, 0.0, 0.0]),
    )
    for frame in range(125):
        if frame == 100:
            robot.change({"scene.payload.mass": 0.2})
            robot.push([0.0, 5.0, 0.0], 0.2)
        robot.advance()
    count = play_page.save(robot, tmp_path / "bag")
    bag = Bag(tmp_path / "bag")
    assert sum(bag.counts.values()) == count
    states, *found = check_bag(bag, 0.0)
    assert states.why == "no record of state_estimator in the bag"
    assert all(stage.compared > 100 for stage in found)
    assert [stage.first for stage in found] == [None] * 3


HERE = "127.0.0.1:8080"


@pytest.mark.parametrize(
    ("host", "origin", "refusal"),
    [
        (HERE, None, ""),
        ("localhost:8080", "http://localhost:8080", ""),
        ("elsewhere.org:8080", None, "unknown host"),
        ("", None, "unknown host"),
        (HERE, "http://elsewhere.org", "another page"),
        (HERE, "http://127.0.0.1:9090", "another page"),
        (HERE, "null", "another page"),
    ],
)
def test_other_names_and_other_pages_are_refused(host, origin, refusal):
    assert Access().refusal("/", host, origin, "") == refusal


@pytest.mark.parametrize(
    ("path", "cookie", "allowed"),
    [
        ("/", "", False),
        ("/?token=abc", "", True),
        ("/?token=abcd", "", False),
        ("/x.js", f"a=b; {COOKIE}=abc", True),
        ("/", f"{COOKIE}=ab", False),
        ("/", f"{COOKIE}=\u00e9", False),
    ],
)
def test_other_machines_need_the_token_in_the_address_or_the_cookie(
    path, cookie, allowed
):
    refusal = Access("abc").refusal(path, "robot:8080", None, cookie)
    assert (refusal == "") == allowed


@pytest.mark.parametrize(
    ("host", "here"),
    [
        ("127.0.0.1", True),
        ("localhost", True),
        ("::1", True),
        ("0.0.0.0", False),
        ("10.0.0.2", False),
        ("robot", False),
    ],
)
def test_only_the_loopback_needs_no_token(host, here):
    assert is_this_machine(host) == here


@pytest.fixture
def server():
    server = start_server("127.0.0.1", 0, "abc")
    yield server
    server.stop()


def test_the_server_checks_pages_and_websockets_and_remembers_the_token(server):
    place = f"127.0.0.1:{server.get_port()}"
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(f"http://{place}/")
    with urllib.request.urlopen(f"http://{place}/?token=abc") as answer:
        cookie = answer.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    known = {"Cookie": cookie.partition(";")[0]}
    for origin, headers in (
        (f"http://{place}", {}),
        ("http://elsewhere.org", known),
    ):
        with pytest.raises(InvalidStatus, match="403"):
            connect(
                f"ws://{place}",
                origin=origin,
                additional_headers=headers,
                proxy=None,
            )
    connect(
        f"ws://{place}",
        origin=f"http://{place}",
        additional_headers=known,
        proxy=None,
    ).close()


def test_no_socket_listens_beyond_this_machine_nor_connects_it_to_a_server_elsewhere(
    server, monkeypatch
):
    monkeypatch.setattr("viser._tunnel.ViserTunnel", None)
    assert server.request_share_url() is None
    sockets = psutil.Process().net_connections()
    listening = {
        each.laddr for each in sockets if each.status == psutil.CONN_LISTEN
    }
    assert ("127.0.0.1", server.get_port()) in listening
    assert {place.ip for place in listening} == {"127.0.0.1"}


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--port", "{}"], "127.0.0.1:{}: Address already in use"),
        (["--host", "no.such.host.invalid"], "no.such.host"),
        (["--scene", "none"], "none"),
        (["--scene", "paper"], "rods"),
        (["--policy", "none"], "none"),
        (["--graph", "--wait", "0"], "does scripts/run run?"),
    ],
)
def test_a_page_that_cannot_be_served_is_refused_in_one_line(
    server, refusal, arguments, reason
):
    port = server.get_port()
    line = refusal(main, *(word.format(port) for word in arguments))
    assert reason.format(port) in line
