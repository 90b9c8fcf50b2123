"""Markers for RViz and Foxglove from the shapes of slot_core.drawing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from slot_core.arrays import Array
from slot_core.drawing.shapes import Arrows, Bars, Box, Shape, Strips, halves
from slot_nodes import messages

HEAD_WIDTH = 3.0  # of an arrow, in widths of its shaft


def shapes_to_msg(stamp: int, shapes: Mapping[str, Shape]) -> MarkerArray:
    """Markers of shapes by name, which becomes the namespace; others stay as they are."""
    return MarkerArray(
        markers=[
            m for name, shape in shapes.items() for m in _markers(stamp, name, shape)
        ]
    )


def _markers(stamp: int, name: str, shape: Shape) -> list[Marker]:
    if isinstance(shape, Box):
        return [_box(stamp, name, shape)]
    if isinstance(shape, Strips):
        return _strips(stamp, name, shape)
    if isinstance(shape, Bars):
        return _bars(stamp, name, shape)
    before = _marker(stamp, name, 0, action=Marker.DELETEALL)  # of this namespace
    return [before, *_arrows(stamp, name, shape)]


def _strips(stamp: int, name: str, strips: Strips) -> list[Marker]:
    return [
        _marker(
            stamp,
            name,
            i,
            type=Marker.LINE_STRIP,
            scale=Vector3(x=strips.width),
            color=_colour(colour),
            points=[_point(p) for p in points.tolist()],
        )
        for i, (points, colour) in enumerate(zip(strips.points, strips.colours))
    ]


def _bars(stamp: int, name: str, bars: Bars) -> list[Marker]:
    triangles = halves(bars.quads).ravel().tolist()
    found = []
    for i, (corners, colour) in enumerate(zip(bars.corners, bars.colours)):
        points = [_point(p) for p in corners.reshape(-1, 3).tolist()]
        found.append(
            _marker(
                stamp,
                name,
                i,
                type=Marker.TRIANGLE_LIST,
                scale=Vector3(x=1.0, y=1.0, z=1.0),
                color=_colour(colour),
                points=[points[k] for k in triangles],
            )
        )
    return found


def _arrows(stamp: int, name: str, arrows: Arrows) -> list[Marker]:
    ends = zip(
        arrows.tail.tolist(), (arrows.tail + arrows.vector).tolist(), arrows.colours
    )
    scale = Vector3(x=arrows.width, y=HEAD_WIDTH * arrows.width)
    return [
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
    ]


def _box(stamp: int, name: str, box: Box) -> Marker:
    x, y, z, w = box.quaternion.tolist()
    pose = Pose(
        position=_point(box.centre.tolist()), orientation=Quaternion(x=x, y=y, z=z, w=w)
    )
    x, y, z = box.size.tolist()
    size = Vector3(x=x, y=y, z=z)
    return _marker(
        stamp,
        name,
        0,
        type=Marker.CUBE,
        pose=pose,
        scale=size,
        color=_colour(box.colour),
    )


def _marker(stamp: int, name: str, number: int, **fields: Any) -> Marker:
    return Marker(header=messages.header(stamp), ns=name, id=number, **fields)


def _point(place: list[float]) -> Point:
    return Point(x=place[0], y=place[1], z=place[2])


def _colour(rgb: Array) -> ColorRGBA:
    r, g, b = rgb.tolist()
    return ColorRGBA(r=r, g=g, b=b, a=1.0)
