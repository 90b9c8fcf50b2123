"""Player of the sensors of a bag into running nodes, in their recorded order and pace."""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from slot_bringup.check import check_place
from slot_bringup.monitor import listener
from slot_core.clock import SECOND, to_seconds
from slot_core.command_line import show
from slot_core.messages import decode
from slot_core.recording.bag_writer import Types, message_types
from slot_core.refusal import InputError
from slot_lab.bags.bag import Bag
from slot_lab.bags.topics import LEG_STATES
from slot_nodes import messages, qos

CLOCK = "/clock"
PLAYED = (
    "/odom",
    "/imu",
    "/joint_states",
    "/servo_health",
    "/cmd_vel",
    "/ground_truth/odom",
    "/ground_truth/legs",
)
"""Topics from outside of the controller: the robot's, and the user's velocity."""
NEEDED = "/odom"
NEWER: dict[str, tuple[str, Any]] = {
    LEG_STATES: ("director", lambda types: np.zeros(0, np.float32)),
    "/servo_health": (
        "supervised",
        lambda types: types.types["builtin_interfaces/msg/Time"](0, 0),
    ),
}
"""Last field of a message, which old bags lack, and its value for them."""
RECORDERS = ("recorder", "rosbag2_recorder")  # nodes
CLOCK_PERIOD = 5_000_000  # ns, at least, between two messages on /clock
SEARCH_TIME = 10.0  # s to wait for a node that subscribes


class PlayError(InputError):
    """A bag cannot be played; the message is one line."""


@dataclass(frozen=True)
class Entry:
    """One message to publish."""

    time: int  # ns, graph time of its publication
    topic: str
    data: bytes


def entries(bag: Bag, start: float) -> Iterator[Entry]:
    """Messages of PLAYED in the order of the bag, from `start` (s) after the first on.

    The graph time is /clock in a bag of a graph in lockstep, else the time of the bag.
    """
    topics = [topic for topic in PLAYED if bag.counts.get(topic)]
    types, clock, first = message_types(), None, None
    for topic, published, data in bag.raw(
        *topics, *([CLOCK] if bag.counts.get(CLOCK) else [])
    ):
        if topic == CLOCK:
            clock = decode.time(bag.decode(topic, data).clock)
            continue
        now = clock if bag.counts.get(CLOCK) else published
        if now is None:
            continue  # before the first /clock
        first = now if first is None else first
        if now - first >= start * SECOND:
            yield Entry(now, topic, readable(bag, topic, data, types))


def readable(bag: Bag, topic: str, data: bytes, types: Types) -> bytes:
    """CDR bytes of a message that nodes can read: it gets the last field, if that is newer."""
    last, default = NEWER.get(topic, ("", None))
    if not last or hasattr(old := bag.decode(topic, data), last):
        return data
    kind = bag.topics[topic]
    known = [getattr(old, name) for name, _ in types.fielddefs[kind][1][:-1]]
    return bytes(
        types.serialize_cdr(types.types[kind](*known, default(types)), kind)
    )


class Player:
    """Publishers of the bag's topics and of /clock."""

    def __init__(self, node: Node, bag: Bag) -> None:
        """Raise PlayError for a bag without odometry, or whose messages are not installed."""
        if not bag.counts.get(NEEDED):
            raise PlayError(f"{bag.path}: holds no {NEEDED}")
        self._node = node
        self._clock = node.create_publisher(Clock, CLOCK[1:], qos.CLOCK)
        self._publishers = {
            topic: node.create_publisher(
                message_class(bag.topics[topic]), topic[1:], qos.SENSOR
            )
            for topic in PLAYED
            if topic in bag.counts
        }
        self._published_time = 0  # ns, last time on /clock

    def wait_for_nodes(self) -> None:
        """Return once a node uses the odometry; raises PlayError after SEARCH_TIME.

        A recorder does not count: it starts before the nodes that use it. Subscribers to the other
        topics are waited for, too, as they would miss the first messages; one of another quality
        of service is never matched, so no longer than SEARCH_TIME. Also raises if a robot publishes
        the odometry already.
        """
        end = time.monotonic() + SEARCH_TIME
        needed = self._publishers[NEEDED]
        while not (
            (used := self._is_used(needed))
            and all(map(self._is_matched, self._publishers.values()))
        ):
            if time.monotonic() > end:
                if used:
                    break
                raise PlayError(
                    f"no node subscribes to {needed.topic_name} within {SEARCH_TIME:g} s:"
                    " start the graph with --hardware none"
                )
            time.sleep(0.05)
        if self._node.count_publishers(needed.topic_name) > 1:
            raise PlayError(
                f"a robot publishes {needed.topic_name} already: start the graph with"
                " --hardware none"
            )

    def _is_used(self, publisher: Publisher) -> bool:
        """Whether every discovered subscriber is matched, and one of them is no recorder."""
        return self._is_matched(publisher) and any(
            reader.node_name not in RECORDERS
            for reader in self._node.get_subscriptions_info_by_topic(
                publisher.topic_name
            )
        )

    def _is_matched(self, publisher: Publisher) -> bool:
        """Whether every discovered subscriber would receive the next message."""
        discovered = self._node.count_subscribers(publisher.topic_name)
        return bool(publisher.get_subscription_count() >= discovered)

    def play(self, played: Iterator[Entry], rate: float) -> tuple[int, float]:
        """Publish the messages; return their number, and the graph time that they span, s."""
        begin, first, count, now = time.monotonic(), None, 0, 0
        for entry in played:
            first, now = entry.time if first is None else first, entry.time
            due = begin + to_seconds(now - first) / rate
            if (early := due - time.monotonic()) > 0:
                time.sleep(early)
            if now >= self._published_time + CLOCK_PERIOD:
                self._published_time = now
                self._clock.publish(Clock(clock=messages.ns_to_stamp(now)))
            self._publishers[entry.topic].publish(entry.data)
            count += 1
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=1))
        return count, 0.0 if first is None else to_seconds(now - first)


def message_class(kind: str) -> type:
    """Class of the messages of a type; raises PlayError if it is not installed."""
    try:
        return messages.message_class(kind)
    except (ImportError, AttributeError):
        raise PlayError(f"messages of {kind} are not installed") from None


def play_bag(options: argparse.Namespace, program: str) -> bool:
    """Play a bag as asked for; False if the output cannot be written. Raises InputError."""
    check_place(options.namespace)
    bag = Bag(options.bag, options.namespace, dict(options.remap))
    if not show(program, bag.lines()):
        return False
    with listener("player", options.namespace) as (node, _):
        player = Player(node, bag)
        player.wait_for_nodes()
        count, span = player.play(entries(bag, options.start), options.rate)
    return show(program, [f"played {count} messages, {span:.2f} s"])
