"""Records the topics of `config/record.yaml` into a bag that `ros2 bag` and Foxglove read.

The node publishes `/recording` when every transient-local topic, those of the controller, has a
matched publisher. A simulated robot that waits for it is recorded from the first tick on.
"""

import json
import time
from collections.abc import Iterator
from importlib import import_module

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import Bool

from slot_core import config
from slot_core.bags.bag_error import BagError
from slot_core.bags.bag_writer import BagWriter
from slot_core.bags.origin import origin_here
from slot_core.bags.record_settings import RecordedTopic, read_record_settings
from slot_nodes import qos, runtime

READY_PERIOD = 0.05  # s, between two checks of the matched publishers


class RecorderNode(Node):
    """Writes serialised messages with the publisher's wall time of publishing.

    A timer takes the messages of all topics at once. To wake up for each of them took four times
    the CPU time; the time of publishing, which the bag holds, does not depend on it.
    """

    def __init__(self) -> None:
        super().__init__("recorder")
        self._settings = read_record_settings(self.get_namespace())
        path = runtime.declare(self, "bag", "", "directory of the bag, which must not exist")
        about = runtime.declare(
            self, "about", "{}", "arguments of the graph, JSON: kept in the bag"
        )
        try:
            self._bag = BagWriter(path, self._settings, origin_here(json.loads(about)))
        except (BagError, OSError) as error:
            raise config.ConfigError(str(error)) from None
        self._recorded = {n: self._listen(n, t) for n, t in self._settings.topics.items()}
        self._awaited = [s for s in self._recorded.values() if _is_latched(s)]
        self._recording = self.create_publisher(Bool, "recording", qos.CONTROL)
        self._ready_timer = runtime.wall_timer(self, READY_PERIOD, self._announce_when_matched)
        self._flushed = time.monotonic()
        runtime.wall_timer(self, self._settings.poll, self._take_and_flush)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """None that the executor has to wait for."""
        return iter(())

    def _announce_when_matched(self) -> None:
        if all(subscription.get_publisher_count() for subscription in self._awaited):
            self._recording.publish(Bool(data=True))
            self.destroy_timer(self._ready_timer)

    def _take_and_flush(self) -> None:
        """Write what has arrived, in chunks of `flush`; end the node if the disk is full."""
        try:
            self._take()
            if time.monotonic() - self._flushed >= self._settings.flush:
                self._flushed = time.monotonic()
                self._bag.flush()
        except BagError as error:
            self.get_logger().fatal(str(error))
            raise SystemExit(1) from None

    def _take(self) -> None:
        for name, subscription in self._recorded.items():
            kind = self._settings.topics[name].type
            while taken := subscription.handle.take_message(subscription.msg_type, True):
                data, info = taken
                self._bag.write(name, kind, info["source_timestamp"], data)

    def destroy_node(self) -> None:
        """Write what has arrived, close the bag, which writes its index, and destroy the node."""
        try:
            self._take()
            self._bag.close()
        except BagError as error:
            runtime.last_logger(self).error(str(error))
        super().destroy_node()

    def _listen(self, name: str, topic: RecordedTopic) -> Subscription:
        package, _, message = topic.type.split("/")
        profile = QoSProfile(
            reliability=ReliabilityPolicy[topic.reliability.upper()],
            durability=DurabilityPolicy[topic.durability.upper()],
            history=HistoryPolicy.KEEP_LAST,
            depth=self._settings.depth,
        )
        kind = getattr(import_module(f"{package}.msg"), message)
        return self.create_subscription(kind, name, _unused, profile, raw=True)


def _is_latched(subscription: Subscription) -> bool:
    return subscription.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL


def _unused(_: bytes) -> None:
    """Callback that is never called: the messages are taken."""


def main() -> None:
    """Entry point of the node."""
    runtime.run(RecorderNode)
