"""A bag is played into running nodes: every message, in order, with the clock; or refused.

No time is asserted: the bags are played a hundred times faster than they were recorded.
"""

from collections import defaultdict
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from synthetic_walk import Walk, message, write_old, write_walk

from slot_bringup import monitor, play
from slot_core.messages import decode
from slot_lab.bags.bag import Bag
from slot_msgs.msg import LegStates, MpcState
from slot_nodes import qos

KEEP = QoSProfile(depth=2000)  # all messages: they are taken after the play
WALK = Path(__file__).parents[1] / "bags" / "walk"


def wait(executor, reached):
    while not reached():
        executor.spin_once(timeout_sec=0.1)


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
            wait(executor, lambda: all(map(other.count_subscribers, arrived)))
            player.wait_for_nodes()
            count, span = player.play(play.entries(bag, 0.0), rate=100.0)
            wait(executor, lambda: sum(map(len, arrived.values())) >= count)
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
def real_time_bag(tmp_path_factory):
    """A bag without /clock, of a robot whose clock is the wall's."""
    return Bag(
        write_walk(tmp_path_factory.mktemp("bags") / "walk", Walk(duration=1.0))
    )


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
        wait(executor, lambda: node.count_subscribers("/odom") == 1)
        with pytest.raises(
            play.PlayError, match="no node subscribes to /odom within"
        ):
            player.wait_for_nodes()
        node.create_subscription(kind, "/odom", print, qos.SENSOR)
        monkeypatch.setattr(play, "SEARCH_TIME", 10.0)
        player.wait_for_nodes()
        node.create_publisher(kind, "/odom", qos.SENSOR)
        wait(executor, lambda: node.count_publishers("/odom") >= 2)
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
