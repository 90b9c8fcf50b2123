"""Bent legs, tendons, forces, reference and paths as markers for RViz and Foxglove."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from slot_core.arrays import Array
from slot_core.drawing.drawing import Bars, Box, Drawing, Shape, Strips, halves
from slot_core.dynamics.servo import read_servo
from slot_core.messages import decode
from slot_core.robot import FLOOR_FRAME, read_robot
from slot_msgs.msg import GaitPreview, LegStates, MpcState, TendonPlan
from slot_nodes import inputs, messages, qos, runtime

PERIOD = 1 / 30  # s, between two messages
HEAD_WIDTH = 3.0  # of an arrow, in widths of its shaft
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
        self._drawing = Drawing(
            read_robot(), float(servo.tendon_stall(servo.nominal_voltage))
        )
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
            self._markers.publish(shapes_to_msg(self._stamp, self._changed))
            self._changed = {}


def shapes_to_msg(stamp: int, shapes: Mapping[str, Shape]) -> MarkerArray:
    """Markers of shapes by name, which becomes the namespace; others stay as they are."""
    return MarkerArray(
        markers=[
            m
            for name, shape in shapes.items()
            for m in _markers(stamp, name, shape)
        ]
    )


def _markers(stamp: int, name: str, shape: Shape) -> list[Marker]:
    if isinstance(shape, Box):
        return [_box(stamp, name, shape)]
    if isinstance(shape, Strips):
        return [
            _marker(
                stamp,
                name,
                i,
                type=Marker.LINE_STRIP,
                scale=Vector3(x=shape.width),
                color=_colour(colour),
                points=[_point(p) for p in points.tolist()],
            )
            for i, (points, colour) in enumerate(
                zip(shape.points, shape.colours)
            )
        ]
    if isinstance(shape, Bars):
        return _bars(stamp, name, shape)
    # of this namespace
    before = _marker(stamp, name, 0, action=Marker.DELETEALL)
    ends = zip(
        shape.tail.tolist(), (shape.tail + shape.vector).tolist(), shape.colours
    )
    scale = Vector3(x=shape.width, y=HEAD_WIDTH * shape.width)
    return [
        before,
        *(
            _marker(
                stamp,
                name,
                i,
                type=Marker.ARROW,
                scale=scale,
                color=_colour(colour),
                points=[_point(tail), _point(head)],
            )
            for i, (tail, head, colour) in enumerate(ends)
        ),
    ]


def _bars(stamp: int, name: str, bars: Bars) -> list[Marker]:
    triangles = halves(bars.quads).ravel()
    return [
        _marker(
            stamp,
            name,
            i,
            type=Marker.TRIANGLE_LIST,
            scale=Vector3(x=1.0, y=1.0, z=1.0),
            color=_colour(colour),
            points=[
                _point(p) for p in corners.reshape(-1, 3)[triangles].tolist()
            ],
        )
        for i, (corners, colour) in enumerate(zip(bars.corners, bars.colours))
    ]


def _box(stamp: int, name: str, box: Box) -> Marker:
    x, y, z, w = box.quaternion.tolist()
    pose = Pose(
        position=_point(box.centre.tolist()),
        orientation=Quaternion(x=x, y=y, z=z, w=w),
    )
    x, y, z = box.size.tolist()
    return _marker(
        stamp,
        name,
        0,
        type=Marker.CUBE,
        pose=pose,
        scale=Vector3(x=x, y=y, z=z),
        color=_colour(box.colour),
    )


def _marker(stamp: int, name: str, number: int, **fields: Any) -> Marker:
    return Marker(
        header=messages.header(stamp, FLOOR_FRAME), ns=name, id=number, **fields
    )


def _point(place: list[float]) -> Point:
    return Point(x=place[0], y=place[1], z=place[2])


def _colour(rgb: Array) -> ColorRGBA:
    r, g, b = rgb.tolist()
    return ColorRGBA(r=r, g=g, b=b, a=1.0)
