"""Publisher of `/servo_health`: at every change, and every 50 ms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.node import Node

from slot_core.clock import SECOND
from slot_msgs import msg as slot_msgs
from slot_nodes import messages, qos, runtime

if TYPE_CHECKING:  # a node imports only the core modules that it runs
    from slot_core.servos.session import ServoSession
    from slot_core.simulation.simulated_servos import DirectServos

PERIOD = 0.05  # s, between two reports without change


class HealthPublisher:
    """Publishes the health of the servos for a node."""

    def __init__(self, node: Node) -> None:
        kind = slot_msgs.ServoHealth
        self._publisher = runtime.publisher(node, kind, "servo_health", qos.SENSOR)
        self._last: tuple[Any, ...] = ()
        self._last_stamp = 0  # ns

    def publish(self, stamp: int, servos: ServoSession | DirectServos) -> None:
        """Publish the health at `stamp` (ns) after a change, PERIOD or a step back of the clock."""
        urgent = servos.urgent
        if urgent != self._last or not 0 <= stamp - self._last_stamp < PERIOD * SECOND:
            self._last, self._last_stamp = urgent, stamp
            self._publisher.publish(messages.health_to_msg(stamp, servos.health(stamp)))
