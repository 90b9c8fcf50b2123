"""Records of a stage on `stage_record`, with which a bag replays it (slot_msgs/msg/StageRecord)."""

from typing import Any

from rclpy.node import Node

from slot_core.clock import to_ns
from slot_core.key_frame import capture
from slot_msgs.msg import StageRecord
from slot_nodes import messages, qos, runtime
from slot_nodes.process import intra_process

KEY_FRAME_PERIOD = 3.0  # s between two key frames
FIRST_PERIOD = 1.0  # s, while a new subscriber may not hear all topics yet
DISCOVERY = 4.0  # s after it came
TAKEN_MAX = 2000  # inputs without an output after which a key frame follows


class Recorder:
    """Publishes the record of a stage, after the outputs for which the command waits."""

    def __init__(self, node: Node, stage: Any) -> None:
        """stage: object of the core whose class may have a STATE; it has taken nothing yet."""
        self._name, self._stage, self._number = node.get_name(), stage, 0
        self._taken: list[int] = []
        self._stamps: list[int] = []
        self._output = 0  # ns, stamp of the last output
        self._due = 0  # ns, of such stamps: of the next key frame
        self._settled = 0  # ns, of such stamps: from which on every subscriber hears all topics
        self._subscribers, self._waits = 0, False
        self._afterwards = intra_process.afterwards()
        self._records = runtime.publisher(
            node, StageRecord, "stage_record", qos.CONTROL
        )
        self._publish("")

    def take(self, topic: int, stamp: int) -> None:
        """Note an input, ODOMETRY, IMU or JOINTS, before the stage gets it; stamp: ns."""
        if len(self._taken) >= TAKEN_MAX:
            self._publish(capture(self._stage))
        self._taken.append(topic)
        self._stamps.append(stamp)

    def put(self, stamp: int) -> None:
        """Note an output with a stamp, ns, after it has been published."""
        self._output = stamp
        if not self._waits:
            self._waits = True
            self._afterwards(self._record)

    def _record(self) -> None:
        """Publish the readings taken, and a key frame if it is due or a new node subscribes."""
        self._waits = False
        count = self._records.get_subscription_count()
        joined, self._subscribers = count > self._subscribers, count
        state = ""
        if joined:
            self._settled = self._output + to_ns(DISCOVERY)
        if joined or not self._output < self._due < self._output + 2 * to_ns(
            KEY_FRAME_PERIOD
        ):
            is_settled = self._output >= self._settled
            self._due = self._output + to_ns(
                KEY_FRAME_PERIOD if is_settled else FIRST_PERIOD
            )
            state = capture(self._stage)
        if state or self._taken:
            self._publish(state)

    def _publish(self, state: str) -> None:
        record = StageRecord(
            header=messages.header(self._output), node=self._name
        )
        record.number, record.taken, record.stamp = (
            self._number,
            self._taken,
            self._stamps,
        )
        record.state = state
        self._records.publish(record)
        self._number += 1
        self._taken, self._stamps = [], []
