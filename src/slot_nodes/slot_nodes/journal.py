"""Journal of a stage: what it takes, in its order, with key frames, on `/stage_inputs`.

With it a bag can be replayed whatever came first: a robot's sensors, the graph or the recorder.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from rclpy.node import Node

from slot_core.clock import SECOND
from slot_core.key_frame import captured, encoded, has_state
from slot_msgs.msg import StageInputs
from slot_nodes import messages, qos, runtime
from slot_nodes.process import intra_process

PERIOD = 4.0  # s of the inputs' stamps, between two key frames
LONGEST = 500  # inputs of a message, where no output comes


class Journal:
    """Publishes the inputs of a stage and, at its first input and every PERIOD, its state."""

    def __init__(self, node: Node, stage: str) -> None:
        """stage: topic of the output."""
        self._stage, self._afterwards = stage, intra_process.afterwards()
        self._publisher = runtime.publisher(node, StageInputs, "stage_inputs", qos.CONTROL)
        self._taken: list[tuple[int, int]] = []
        self._frame: dict[str, Any] | None = None
        self._framed: int | None = None  # ns, input of the last key frame

    def take(self, core: Any, source: int, stamp: int) -> None:
        """Note an input that the core is about to take, by its source and stamp (ns)."""
        if not self._taken:
            self._frame = self._due(core, stamp)
        self._taken.append((source, stamp))
        if len(self._taken) >= LONGEST:
            self.close(stamp)

    def close(self, stamp: int) -> None:
        """Publish what was taken for the output with this stamp (ns)."""
        taken, self._taken = self._taken, []
        frame, self._frame = self._frame, None
        self._afterwards(partial(self._publish, stamp, taken, frame))

    def begin(self, core: Any, stamp: int) -> None:
        """Publish a key frame, if one is due, before the core takes the inputs with this stamp."""
        first = self._framed is None
        frame = self._due(core, stamp)
        if frame is not None or first:
            self._afterwards(partial(self._publish, stamp, [], frame))

    def _due(self, core: Any, stamp: int) -> dict[str, Any] | None:
        """The state of the core, if its last key frame is older than PERIOD or in the future."""
        age = None if self._framed is None else stamp - self._framed
        if age is not None and 0 <= age < PERIOD * SECOND:
            return None
        self._framed = stamp
        return captured(core) if has_state(core) else None

    def _publish(
        self, stamp: int, taken: list[tuple[int, int]], frame: dict[str, Any] | None
    ) -> None:
        self._publisher.publish(
            StageInputs(
                header=messages.header(stamp),
                stage=self._stage,
                source=[source for source, _ in taken],
                stamp=[when for _, when in taken],
                state=b"" if frame is None else encoded(frame),
            )
        )
