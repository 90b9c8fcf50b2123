"""Records the topics of `config/record.yaml` into a bag that `ros2 bag` and Foxglove read."""

from importlib import import_module

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from slot_core.evaluation.bag import BagWriter, RecordedTopic, read_record_settings
from slot_nodes import runtime


class RecorderNode(Node):
    """Writes raw messages; the time of a message is its publisher's wall clock at publishing."""

    def __init__(self) -> None:
        super().__init__("recorder")
        settings = read_record_settings()
        path = runtime.declare(self, "bag", "", "directory of the bag, which must not exist")
        self._depth = settings.depth
        self._bag = BagWriter(path, settings)
        for name, topic in settings.topics.items():
            self._record(name, topic)

    def destroy_node(self) -> None:
        """Close the bag: only then it has its index."""
        super().destroy_node()
        self._bag.close()

    def _record(self, name: str, topic: RecordedTopic) -> None:
        def write(data: bytes, info: dict) -> None:
            self._bag.write(name, topic.type, info["source_timestamp"], data)

        package, _, message = topic.type.split("/")
        profile = QoSProfile(
            reliability=ReliabilityPolicy[topic.reliability.upper()],
            durability=DurabilityPolicy[topic.durability.upper()],
            history=HistoryPolicy.KEEP_LAST,
            depth=self._depth,
        )
        kind = getattr(import_module(f"{package}.msg"), message)
        self.create_subscription(kind, name, write, profile, raw=True)


def main() -> None:
    """Entry point of the node."""
    runtime.run(RecorderNode)
