"""Records the topics of `config/record.yaml` into a bag that `ros2 bag` and Foxglove read.

The node publishes `/recording` from when on every transient-local topic, those of the controller,
has a matched publisher; repeated, so that a robot that has missed it does not wait for ever. A
simulated robot that waits for it is recorded from the first tick on.

In a process with other nodes, in lockstep, it gets their messages without DDS, and writes the bytes
that DDS would have sent. A topic on which nodes of other processes may publish too it reads by DDS.

The bag says on `/recorded_nodes` which nodes published its topics, as JSON, as often as that
changes: a replay tells a node of a user's own from ours.
"""

import json
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, cast

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from std_msgs.msg import Bool, String

from slot_core import config
from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.origin import origin_here
from slot_core.recording.record_settings import (
    BagError,
    RecordedTopic,
    read_record_settings,
    root_of,
)
from slot_nodes import inputs, messages, qos, runtime
from slot_nodes.process import intra_process
from slot_nodes.process.executor import PolledGroup

SENSORS = (  # types of which drivers publish best effort
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/Imu",
)
SHARED = {
    "tf2_msgs/msg/TFMessage",
    "diagnostic_msgs/msg/DiagnosticArray",
}  # types of topics on which nodes of several processes publish
NODES = "recorded_nodes"  # topic in the bag alone: nodes by the topic that they publish
ANNOUNCEMENT = 1.0  # s, between two messages that it records


class RecorderNode(Node):
    """Writes serialised messages with the publisher's wall time of publishing.

    It takes the messages of all topics at once, `poll` apart. To wake up for each of them took
    several times the CPU time; the time of publishing, which the bag holds, does not depend on it.
    """

    def __init__(self) -> None:
        super().__init__("recorder")
        stamped = runtime.declare(
            self, "stamped_cmd_vel", True, "/cmd_vel is a TwistStamped"
        )
        self._settings = read_record_settings(self.get_namespace(), stamped)
        path = runtime.declare(
            self, "bag", "", "directory of the bag, which must not exist"
        )
        about = runtime.declare(
            self, "about", "{}", "arguments of the graph, JSON: kept in the bag"
        )
        try:
            self._bag = BagWriter(
                path, self._settings, origin_here(json.loads(about))
            )
        except (BagError, OSError) as error:
            raise config.ConfigError(str(error)) from None
        self._best_effort = runtime.declare(
            self,
            "best_effort_sensors",
            False,
            "record sensors that publish best effort too",
        )
        # a publisher prefixes the frames of what it sends by DDS
        self._prefixes_frames = bool(runtime.frame_prefix(self))
        self._polled = PolledGroup()
        self._recorded: dict[str, Subscription] = {}  # by DDS
        for name, topic in self._settings.topics.items():
            self._listen(name, topic)
        self._awaited = {
            name
            for name, s in self._recorded.items()
            if s.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        }
        self._recording = self.create_publisher(Bool, "recording", qos.STATE)
        self._announced = -math.inf  # s, monotonic
        self._nodes: dict[str, set[str]] = {}  # that have published each topic
        self._flushed = time.monotonic()
        runtime.wall_timer(self, self._settings.poll, self._work)

    def _work(self) -> None:
        """Write what has arrived by DDS, and flush the bag when it is due."""
        with self._ended_by_the_disk():
            self._take()
            self._announce_when_matched()
            if time.monotonic() - self._flushed >= self._settings.flush:
                self._flushed = time.monotonic()
                self._note_nodes()
                self._bag.flush()

    @contextmanager
    def _ended_by_the_disk(self) -> Iterator[None]:
        """End the process on BagError, which as a ValueError would only refuse a message in work."""
        try:
            yield
        except BagError as error:
            self.get_logger().fatal(str(error))
            raise SystemExit(1) from None

    def _take(self) -> None:
        """Write all messages that have arrived."""
        for name, subscription in self._recorded.items():
            while taken := subscription.handle.take_message(
                subscription.msg_type, True
            ):
                self._write(name, *taken)

    def _write(self, name: str, data: bytes, info: Any) -> None:
        self._bag.write(
            name,
            self._settings.topics[name].type,
            info["source_timestamp"],
            data,
        )

    def _write_message(self, name: str, message: Any) -> None:
        """Write a message of this process, as it is published."""
        info = {"source_timestamp": time.time_ns()}
        with self._ended_by_the_disk():
            self._write(name, messages.cdr(message), info)

    def _announce_when_matched(self) -> None:
        now = time.monotonic()
        if now - self._announced < ANNOUNCEMENT:
            return
        self._awaited = {
            name
            for name in self._awaited & self._recorded.keys()
            if not self._recorded[name].get_publisher_count()
        }
        if not self._awaited:
            self._recording.publish(Bool(data=True))
            self._announced = now

    def _note_nodes(self) -> None:
        """Write which nodes have published the topics, if others have joined."""
        before = {topic: set(nodes) for topic, nodes in self._nodes.items()}
        for topic in self._settings.topics:
            found = self.get_publishers_info_by_topic(topic)
            known = {
                inputs.full_name(i)
                for i in found
                if inputs.UNKNOWN not in i.node_name
            }
            if known:
                self._nodes.setdefault(topic, set()).update(known)
        if self._nodes != before:
            text = json.dumps(
                {topic: sorted(nodes) for topic, nodes in self._nodes.items()}
            )
            data = serialize_message(String(data=text))
            self._bag.write(
                f"{root_of(self.get_namespace())}/{NODES}",
                "std_msgs/msg/String",
                time.time_ns(),
                data,
            )

    def close(self) -> None:
        """Write the received messages and close the bag, which writes its index."""
        try:
            self._take()
            self._bag.close()
        except BagError as error:
            runtime.last_logger(self).error(str(error))

    def _listen(self, name: str, topic: RecordedTopic) -> None:
        """Record a topic by DDS, until a node of the process publishes it."""
        kind = messages.message_class(topic.type)
        profile = qos.recorded(topic, self._settings.depth)
        if self._best_effort and topic.type in SENSORS:
            profile = qos.best_effort(profile)
        # rclpy also passes the second argument; its annotation has only the first
        write = cast(Any, partial(self._write, name))
        made = self.create_subscription(
            kind, name, write, profile, raw=True, callback_group=self._polled
        )
        self._recorded[name] = made
        if not (topic.type in SHARED or self._prefixes_frames):
            intra_process.record(
                made.topic_name,
                partial(self._write_message, name),
                lambda: self.destroy_subscription(self._recorded.pop(name)),
            )
