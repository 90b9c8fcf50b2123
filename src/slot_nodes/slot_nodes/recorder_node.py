"""Records the topics of `config/record.yaml` into a bag that `ros2 bag` and Foxglove read.

The node publishes `/recording` when every transient-local topic, those of the controller, has a
matched publisher. A simulated robot that waits for it is recorded from the first tick on.
"""

from importlib import import_module
from typing import Any, cast

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import Bool

from slot_core import config
from slot_core.bags.bag import BagError, BagWriter, RecordedTopic, read_record_settings
from slot_nodes import qos, runtime

READY_PERIOD = 0.05  # s, between two checks of the matched publishers


class RecorderNode(Node):
    """Writes serialised messages with the publisher's wall time of publishing."""

    def __init__(self) -> None:
        super().__init__("recorder")
        settings = read_record_settings(self.get_namespace())
        path = runtime.declare(self, "bag", "", "directory of the bag, which must not exist")
        self._depth = settings.depth
        try:
            self._bag = BagWriter(path, settings)
        except BagError as error:
            raise config.ConfigError(str(error)) from None
        self._awaited: list[Subscription] = []
        for name, topic in settings.topics.items():
            self._record(name, topic)
        self._recording = self.create_publisher(Bool, "recording", qos.CONTROL)
        self._timer = runtime.wall_timer(self, READY_PERIOD, self._announce_when_matched)

    def _announce_when_matched(self) -> None:
        if all(subscription.get_publisher_count() for subscription in self._awaited):
            self._recording.publish(Bool(data=True))
            self.destroy_timer(self._timer)

    def destroy_node(self) -> None:
        """Destroy the node and close the bag, which writes its index."""
        super().destroy_node()
        self._bag.close()

    def _record(self, name: str, topic: RecordedTopic) -> None:
        def write(data: bytes, info: Any) -> None:
            self._bag.write(name, topic.type, info["source_timestamp"], data)

        package, _, message = topic.type.split("/")
        profile = QoSProfile(
            reliability=ReliabilityPolicy[topic.reliability.upper()],
            durability=DurabilityPolicy[topic.durability.upper()],
            history=HistoryPolicy.KEEP_LAST,
            depth=self._depth,
        )
        kind = getattr(import_module(f"{package}.msg"), message)
        # rclpy also passes the second argument; its annotation has only the first
        subscription: Subscription = self.create_subscription(
            kind, name, cast(Any, write), profile, raw=True
        )
        if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            self._awaited.append(subscription)


def main() -> None:
    """Entry point of the node."""
    runtime.run(RecorderNode)
