"""Bent legs, tendons, forces, reference and paths as markers for RViz and Foxglove."""

from functools import partial
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from slot_core.drawing.drawing import Drawing
from slot_core.drawing.shapes import Shape
from slot_core.dynamics.servo import read_servo
from slot_core.messages import decode
from slot_core.robot import read_robot
from slot_msgs.msg import GaitPreview, LegStates, MpcState, TendonPlan
from slot_nodes import inputs, qos, runtime
from slot_nodes.visualization import markers

PERIOD = 1 / 30  # s, between two messages
INPUTS = {
    "ground_truth/odom": (Odometry, qos.SENSOR),
    "ground_truth/legs": (LegStates, qos.SENSOR),
    "joint_states": (JointState, qos.SENSOR),
    "mpc_state": (MpcState, qos.STATE),
    "gait_preview": (GaitPreview, qos.STATE),
    "tendon_plan": (TendonPlan, qos.STATE),
}


class VisualizerNode(Node):
    """Publishes the shapes that have changed since the last message."""

    def __init__(self) -> None:
        super().__init__("visualizer")
        servo = read_servo()
        loaded = float(servo.tendon_stall(servo.nominal_voltage))
        self._drawing = Drawing(read_robot(), loaded)
        self._changed: dict[str, Shape] = {}
        self._stamp = 0  # ns, of the newest input
        self._markers = runtime.publisher(
            self, MarkerArray, "visualization", qos.SENSOR
        )
        for topic, (kind, profile) in INPUTS.items():
            inputs.subscribe(
                self, kind, topic, partial(self._on_message, topic), profile
            )
        self._timer = runtime.wall_timer(self, PERIOD, self._publish)

    def _on_message(self, topic: str, message: Any) -> None:
        self._changed |= self._drawing.receive(f"/{topic}", message)
        self._stamp = decode.stamp(message)

    def _publish(self) -> None:
        if self._changed:
            self._markers.publish(markers.shapes_to_msg(self._stamp, self._changed))
            self._changed = {}


def main() -> None:
    """Entry point of the node."""
    runtime.run(VisualizerNode)
