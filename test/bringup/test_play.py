"""A bag is played into running nodes: every message, in order, with the clock; or refused.

No time is asserted: the bags are played a hundred times faster than they were recorded.

scripts/view: which run it shows, where it writes its page, and when it opens a browser.

Keys that steer the robot, and what they publish.
"""

import math
import os
import time
from collections import defaultdict
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
from bag_messages import message, write_old
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock

from slot_bringup import monitor, operator_screen, play, steering, view
from slot_bringup.playing import main_page
from slot_core.messages import decode
from slot_lab.bags.bag import Bag
from slot_msgs.msg import GaitPreview, LegStates, MpcState, RobotState
from slot_nodes import messages, qos

KEEP = QoSProfile(depth=2000)  # all messages: they are taken after the play
WALK = Path(__file__).parents[1] / "bags" / "walk"


def test_every_sensor_message_arrives_as_it_was_recorded_with_the_clock_of_its_graph():
    bag, arrived, clock = Bag(WALK), defaultdict(list), []
    with monitor.listener("listener") as (node, executor):
        for topic in bag.topics.keys() & play.PLAYED:
            kind = play.message_class(bag.topics[topic])
            take = arrived[topic].append
            node.create_subscription(kind, topic, take, KEEP, raw=True)
        node.create_subscription(Clock, "/clock", clock.append, qos.CLOCK)
        with monitor.listener("player") as (other, _):
            player = play.Player(other, bag)
            executor.spin_until(
                lambda: all(map(other.count_subscribers, arrived)), math.inf
            )
            player.wait_for_nodes()
            count, span = player.play(play.entries(bag, 0.0), rate=100.0)
            executor.spin_until(
                lambda: sum(map(len, arrived.values())) >= count, math.inf
            )
    recorded = defaultdict(list)
    for topic, _, data in bag.raw(*arrived):
        recorded[topic].append(data)
    assert {"/odom", "/imu", "/joint_states"} <= recorded.keys()
    for topic in recorded.keys() - play.NEWER:  # which may lack a field
        assert [bytes(m) for m in arrived[topic]] == recorded[topic], topic
    assert count == sum(map(len, recorded.values()))
    times = [decode.time(message.clock) for message in clock]
    ticks = [decode.time(m.clock) for _, m in bag.messages("/clock")]
    assert span == pytest.approx((ticks[-1] - ticks[0]) * 1e-9, abs=0.1)
    assert times == sorted(set(times))
    assert set(times) <= set(ticks)


def test_a_message_of_before_its_last_field_arrives_in_a_form_that_nodes_can_read(
    tmp_path,
):
    shape = {"nodes": 2, "position": np.arange(24.0)}
    legs = message("/ground_truth/legs", 1.0, **shape)
    old = write_old(tmp_path / "legs", "/ground_truth/legs", legs)
    (entry,) = play.entries(Bag(old), 0.0)
    legs = deserialize_message(entry.data, LegStates)
    assert (legs.nodes, [*legs.position], [*legs.director]) == (
        2,
        [*range(24)],
        [],
    )


@pytest.fixture(scope="module")
def real_time_bag():
    """A bag without /clock, of a robot whose clock is the wall's."""
    return Bag(Path(__file__).parents[2] / "slot_bringup" / "example" / "walk")


def test_without_a_recorded_clock_the_time_of_the_bag_is_the_clock(
    real_time_bag,
):
    """`ros2 bag record` lists the /clock of a robot in real time, which publishes none."""
    every, late = (
        [*play.entries(real_time_bag, start)] for start in (0.0, 0.6)
    )
    raw = ((t, topic) for topic, t, _ in real_time_bag.raw())
    played = [(t, topic) for t, topic in raw if topic in play.PLAYED]
    assert [(entry.time, entry.topic) for entry in every] == played
    assert late[0].time - every[0].time == pytest.approx(0.6e9, abs=0.01e9)
    assert late[-1] == every[-1]
    bag = MagicMock(counts={"/odom": 2, "/clock": 0})
    bag.raw.return_value = [("/odom", t, b"") for t in (5, 9)]
    assert [entry.time for entry in play.entries(bag, 0.0)] == [5, 9]


def test_a_bag_is_not_played_where_nothing_uses_it_or_a_robot_runs(
    real_time_bag, monkeypatch
):
    """A recorder alone does not count: the nodes, which start later, would miss the first."""
    monkeypatch.setattr(play, "SEARCH_TIME", 0.2)
    kind = play.message_class(real_time_bag.topics["/odom"])
    with monitor.listener("player") as (node, executor):
        player = play.Player(node, real_time_bag)
        recorder = Node("recorder", context=node.context)
        recorder.create_subscription(kind, "/odom", print, qos.SENSOR)
        executor.spin_until(
            lambda: node.count_subscribers("/odom") == 1, math.inf
        )
        with pytest.raises(
            play.PlayError, match="no node subscribes to /odom within"
        ):
            player.wait_for_nodes()
        node.create_subscription(kind, "/odom", print, qos.SENSOR)
        monkeypatch.setattr(play, "SEARCH_TIME", 10.0)
        player.wait_for_nodes()
        node.create_publisher(kind, "/odom", qos.SENSOR)
        executor.spin_until(
            lambda: node.count_publishers("/odom") >= 2, math.inf
        )
        with pytest.raises(
            play.PlayError, match="a robot publishes /odom already"
        ):
            player.wait_for_nodes()


@pytest.mark.parametrize("played", [True, False])
def test_a_run_ends_with_the_bag_that_is_played_into_it(
    played, monkeypatch, capsys
):
    """Without a bag the end of the states is an error. A slow run is said, with the remedy."""
    monkeypatch.setattr(monitor, "SILENCE_TIMEOUT", 0.3)
    monkeypatch.setattr(monitor.Progress, "slowness", lambda _: "slower")
    running = {"failed.return_value": None, "restart_ended.return_value": []}
    ended = pytest.raises(monitor.RunError, match="no /mpc_state")
    with monitor.listener("state_estimator", "alone") as (node, _):
        node.create_publisher(MpcState, "mpc_state", qos.CONTROL).publish(
            MpcState()
        )
        with nullcontext() if played else ended:
            given = {"namespace": "alone", "played": played, "remedy": "wait"}
            monitor.watch(MagicMock(**running), 60.0, **given)
    assert "scripts/run: slower; wait" in capsys.readouterr().err


def test_a_run_is_written_into_its_folder_and_opened(
    monkeypatch, refusal, tmp_path
):
    """On a machine with a display."""
    opened = []
    monkeypatch.setattr(main_page.webbrowser, "open", opened.append)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.chdir(tmp_path)
    line = refusal(view.main)
    assert line.startswith("scripts/view: no bag in /")
    assert "/bags: name one, or make one by scripts/run" in line
    bag = Path("bags/walk")
    Bag(WALK).save(bag)
    page = bag.absolute() / view.PAGE
    for words in ([], ["--no-browser"], ["--html", "other.html"]):
        assert view.main(words) == 0
    monkeypatch.delenv("DISPLAY")
    assert view.main([str(bag)]) == 0
    assert page.exists()
    assert opened == [page.as_uri()]


def test_the_newest_bag_is_shown_by_default(tmp_path):
    newest, older = (tmp_path / f"walk_{i}" / "walk.mcap" for i in (2, 1))
    for age, file in enumerate([newest, older]):
        file.parent.mkdir()
        file.touch()
        os.utime(file, (1e9 - age, 1e9 - age))
    older.with_name(view.PAGE).touch()  # of an older run that was shown last
    (tmp_path / "plots_of_a_film").mkdir()
    assert view.newest_bag(tmp_path) == newest.parent


def test_the_live_page_of_a_run_waits_for_its_graph_and_ends_with_it(
    monkeypatch, tmp_path
):
    program, words, done = (
        tmp_path / "python",
        tmp_path / "words",
        tmp_path / "done",
    )
    program.write_text(
        f"#!/bin/sh\ntrap 'touch {done}; exit' TERM\necho $@ >{words}.new\nmv {words}.new {words}\n"
        "while :; do sleep 0.1; done\n"
    )
    program.chmod(0o755)
    monkeypatch.setattr(main_page.sys, "executable", str(program))
    with main_page.live_page("fred", 90.0):
        while not words.exists():
            time.sleep(0.01)
        assert not done.exists()
    assert done.exists()
    assert "--graph --namespace fred --wait 90.0 --open" in words.read_text()


UP, DOWN, RIGHT, LEFT = (f"\x1b[{letter}" for letter in "ABCD")
STATE = RobotState(
    header=messages.header(7_000_000_000), action=RobotState.ACTION_PASS
)


class Keys(steering.SteeringKeys):
    """Keys that keep what they publish, in a graph that hears one type of /cmd_vel."""

    def __init__(self, heard="TwistStamped"):
        self.published = []
        topic = SimpleNamespace(publish=self.published.append)
        info = SimpleNamespace(topic_type=f"geometry_msgs/msg/{heard}")
        node = {"create_publisher": lambda *_: topic}
        node["get_subscriptions_info_by_topic"] = lambda _: [info]
        super().__init__(SimpleNamespace(**node))


def commanded(velocity=(0.0, 0.0, 0.0), gait="walk"):
    return GaitPreview(
        requested=gait, velocity=list(velocity), pose=[0.06, 0.0, 0.0]
    )


@pytest.mark.parametrize(
    ("pressed", "velocity"),
    [
        ([UP], [0.01, 0.0, 0.0]),
        ([UP, UP, DOWN, UP], [0.02, 0.0, 0.0]),
        ([","], [0.0, 0.01, 0.0]),  # to the left
        ([LEFT], [0.0, 0.0, 0.025]),
        ([RIGHT, LEFT, "."], [0.0, -0.01, 0.0]),
    ],
)
@pytest.mark.parametrize("heard", [Twist, TwistStamped])
def test_a_key_changes_the_velocity_that_is_repeated_in_the_type_that_is_heard(
    pressed, velocity, heard
):
    keys = Keys(heard.__name__)
    for key in pressed:
        assert keys.press(key, commanded()).startswith("velocity ")
    keys.repeat(STATE, commanded())
    (message,) = keys.published
    assert type(message) is heard
    stamp, sent = decode.velocity(message)
    assert stamp == (decode.stamp(STATE) if heard is TwistStamped else 0)
    np.testing.assert_allclose(sent, velocity, atol=1e-15)


def test_a_velocity_beyond_the_reach_of_the_gait_is_clipped_and_does_not_wind_up():
    """The first key goes on from what is commanded."""
    keys, present = Keys(), commanded([0.03, 0.0, 0.0])
    keys.press(UP, present)
    keys.repeat(STATE, present)
    assert decode.velocity(keys.published[0])[1] == pytest.approx(
        [0.04, 0.0, 0.0]
    )
    said = [keys.press(UP, present) for _ in range(20)]
    assert said[-1].startswith("velocity clipped to the reach of gait walk")
    keys.press(DOWN, present)
    keys.repeat(STATE, present)
    assert decode.velocity(keys.published[1])[1][0] < 0.1  # not 0.19


def test_zero_is_repeated_until_it_is_commanded_then_another_may_steer():
    """Before the first key nothing is published either. A velocity ends with the torque."""
    keys = Keys()
    keys.repeat(STATE, commanded())
    assert not keys.published
    keys.press(UP, commanded())
    keys.press(steering.STOP, commanded())
    for velocity, count in ((0.01, 1), (0.01, 2), (0.0, 3), (0.0, 3)):
        keys.repeat(STATE, commanded([velocity, 0.0, 0.0]))
        assert len(keys.published) == count
    keys.press(UP, commanded())
    keys.repeat(RobotState(), commanded([0.01, 0.0, 0.0]))  # without torque
    assert not decode.velocity(keys.published[-1])[1].any()


@pytest.mark.parametrize(
    ("pressed", "pose"),
    [
        ("u", [0.062, 0.0, 0.0]),
        ("oo", [0.056, 0.0, 0.0]),
        ("lli", [0.06, math.radians(2.0), math.radians(1.0)]),
        ("jk", [0.06, -math.radians(1.0), -math.radians(1.0)]),
    ],
)
def test_a_key_changes_height_and_attitude_up_to_a_limit(pressed, pose):
    keys = Keys()
    for key in pressed:
        assert keys.press(key, commanded()).startswith("height ")
    assert isinstance(keys.published[-1], PoseStamped)
    np.testing.assert_allclose(
        decode.body_pose(keys.published[-1]), pose, atol=1e-9
    )
    said = [keys.press(pressed[-1], commanded()) for _ in range(40)]
    assert "reaches [" in said[-1]
    assert len(keys.published) < 40


def test_other_keys_do_not_steer_nor_any_without_a_gait_scheduler():
    keys = Keys()
    for key in (
        *operator_screen.KEYS,
        operator_screen.QUIT,
        "a",
        "\x1b",
        "\x1b[5~",
    ):
        assert keys.press(key, commanded()) == ""
    for key in (UP, "u", steering.STOP):
        assert keys.press(key, None) == "no gait_scheduler answers"
    assert not keys.published


def test_keys_are_told_apart_in_what_a_terminal_sends():
    sent = ["w", UP, LEFT, "q", "\x1b[5~", "\x1bOA", " "]
    assert operator_screen.KEY.findall("".join(sent)) == sent
