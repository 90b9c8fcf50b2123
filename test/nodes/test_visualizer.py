"""The node visualizer and its markers: what RViz and Foxglove get to draw."""

from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from visualization_msgs.msg import Marker

from slot_core.drawing import drawing as shapes
from slot_core.robot import read_robot
from slot_msgs.msg import LegStates
from slot_nodes import messages
from slot_nodes.visualizer_node import VisualizerNode, shapes_to_msg

ROBOT = read_robot()
STILL = np.array([0.0, 0.0, 0.0, 1.0])
PLACE = np.array([0.1, 0.2, 0.3])
LEGS = shapes.natural_legs(PLACE, STILL, ROBOT, 10)
NODES = LEGS.nodes


def points_of(marker):
    return np.array([[p.x, p.y, p.z] for p in marker.points])


def test_bent_legs_are_four_solids_in_their_colours_and_place():
    bars = shapes.leg_bars(LEGS, ROBOT)
    message = shapes_to_msg(7_000_000_001, {"legs": bars})
    assert [(m.ns, m.id, m.type) for m in message.markers] == [
        ("legs", i, Marker.TRIANGLE_LIST) for i in range(4)
    ]
    for marker, faces, colour in zip(
        message.markers, bars.faces, shapes.LEG_COLOURS
    ):
        halves = np.stack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]], axis=1)
        assert np.allclose(points_of(marker), halves.reshape(-1, 3))
        assert np.allclose(
            [marker.color.r, marker.color.g, marker.color.b], colour
        )
        # else nothing is shown
        assert (marker.color.a, marker.pose.orientation.w) == (1.0, 1.0)
        assert (marker.scale.x, marker.scale.y, marker.scale.z) == (
            1.0,
            1.0,
            1.0,
        )
        assert (marker.header.frame_id, marker.header.stamp.nanosec) == (
            "floor",
            1,
        )


def test_forces_replace_all_those_of_before():
    force = np.array([[0.0, 0.0, 5.0], [0.0] * 3, [1.0, 0.0, 2.0], [0.0] * 3])
    arrows = shapes.force_arrows(NODES[:, -1], force, shapes.LEG_COLOURS)
    before, *drawn = shapes_to_msg(0, {"ground_forces": arrows}).markers
    assert (before.action, before.ns) == (Marker.DELETEALL, "ground_forces")
    assert [m.type for m in drawn] == [Marker.ARROW, Marker.ARROW]
    tail, head = points_of(drawn[0])
    assert np.allclose(tail, NODES[0, -1])
    assert np.allclose(head - tail, [0.0, 0.0, 5.0 * shapes.FORCE_SCALE])


def test_the_torso_is_a_box_in_its_pose():
    turned = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    (marker,) = shapes_to_msg(
        0, {"torso": shapes.torso_box(PLACE, turned, ROBOT)}
    ).markers
    assert marker.type == Marker.CUBE
    assert [marker.scale.x, marker.scale.y, marker.scale.z] == list(
        ROBOT.torso.size
    )
    assert marker.pose.position.y == pytest.approx(0.2)
    assert marker.pose.orientation.z == pytest.approx(np.sqrt(0.5))


@pytest.fixture
def node():
    rclpy.init()
    made = VisualizerNode()
    yield made
    made.destroy_node()
    rclpy.shutdown()


def test_the_node_publishes_what_has_changed_once(node):
    published = []
    node._markers = SimpleNamespace(publish=published.append)
    node._publish()
    assert not published
    legs = LegStates(
        nodes=10, position=NODES.astype(np.float32).ravel(), tension=[1.0] * 4
    )
    legs.header = messages.header(3_000_000_000)
    node._on_message("ground_truth/legs", legs)
    node._publish()
    node._publish()
    (message,) = published
    assert {m.ns for m in message.markers} == {
        "legs",
        "tendons",
        "ground_forces",
    }
    assert {m.header.stamp.sec for m in message.markers} == {3}
