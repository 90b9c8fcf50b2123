"""Records the topics of `config/record.yaml` into a bag that `ros2 bag` and Foxglove read.

Says so on `/recording` once it is matched with all of the controller, whose topics are the
transient-local ones; a simulated robot that waits for it is then recorded from the first tick on.
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

READY_PERIOD = 0.05  # s, between looks at what is matched


class RecorderNode(Node):
    """Writes raw messages; the time of a message is its publisher's wall clock at publishing."""

    def __init__(self) -> None:
        super().__init__("recorder")
        settings = read_record_settings()
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
        self._timer = runtime.wall_timer(self, READY_PERIOD, self._tell_when_ready)

    def _tell_when_ready(self) -> None:
        if all(subscription.get_publisher_count() for subscription in self._awaited):
            self._recording.publish(Bool(data=True))
            self.destroy_timer(self._timer)

    def destroy_node(self) -> None:
        """Close the bag: only then it has its index."""
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
        # rclpy passes the second argument too; its annotation knows the first alone
        subscription: Subscription = self.create_subscription(
            kind, name, cast(Any, write), profile, raw=True
        )
        if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            self._awaited.append(subscription)


def main() -> None:
    """Entry point of the node."""
    runtime.run(RecorderNode)
