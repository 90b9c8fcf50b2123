"""Keys that steer the robot, and what they publish."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped

from slot_bringup import operator_keys, steering
from slot_core.messages import decode
from slot_msgs.msg import GaitPreview

UP, DOWN, RIGHT, LEFT = (f"\x1b[{letter}" for letter in "ABCD")
STAMP = 7_000_000_000


class Node:
    """Node that keeps what it publishes, in a graph that hears one type of /cmd_vel."""

    def __init__(self, heard="geometry_msgs/msg/TwistStamped"):
        self.heard, self.published = heard, []

    def create_publisher(self, kind, topic, _):
        return SimpleNamespace(msg_type=kind, publish=self.published.append)

    def get_subscriptions_info_by_topic(self, topic):
        assert topic == "cmd_vel"
        return [SimpleNamespace(topic_type=self.heard)]


def commanded(velocity=(0.0, 0.0, 0.0), gait="walk"):
    return GaitPreview(requested=gait, velocity=list(velocity), pose=[0.06, 0.0, 0.0])


@pytest.fixture
def node():
    return Node()


@pytest.fixture
def keys(node):
    return steering.SteeringKeys(node)


@pytest.mark.parametrize(
    ("pressed", "velocity"),
    [
        ([UP], [0.01, 0.0, 0.0]),
        ([UP, UP, DOWN, UP], [0.02, 0.0, 0.0]),
        ([","], [0.0, 0.01, 0.0]),  # to the left
        ([LEFT], [0.0, 0.0, 0.025]),
        ([RIGHT, LEFT, "."], [0.0, -0.01, 0.0]),
    ],
)
@pytest.mark.parametrize("heard", [Twist, TwistStamped])
def test_a_key_changes_the_velocity_that_is_repeated_in_the_type_that_is_heard(
    pressed, velocity, heard
):
    node = Node(f"geometry_msgs/msg/{heard.__name__}")
    keys = steering.SteeringKeys(node)
    for key in pressed:
        assert keys.press(key, commanded()).startswith("velocity ")
    keys.repeat(STAMP, commanded())
    (message,) = node.published
    assert type(message) is heard
    stamp, sent = decode.velocity(message)
    assert stamp == (STAMP if heard is TwistStamped else 0)
    np.testing.assert_allclose(sent, velocity, atol=1e-15)


def test_the_first_key_goes_on_from_what_is_commanded(node, keys):
    keys.press(UP, commanded([0.03, 0.0, 0.0]))
    keys.repeat(STAMP, commanded([0.03, 0.0, 0.0]))
    assert decode.velocity(node.published[0])[1] == pytest.approx([0.04, 0.0, 0.0])


def test_a_velocity_beyond_the_reach_of_the_gait_is_clipped_and_does_not_wind_up(
    node, keys
):
    said = [keys.press(UP, commanded()) for _ in range(20)]
    assert said[-1].startswith("velocity clipped to the reach of gait walk")
    keys.press(DOWN, commanded())
    keys.repeat(STAMP, commanded())
    assert decode.velocity(node.published[0])[1][0] < 0.1  # not 0.19


def test_zero_is_repeated_until_it_is_commanded_then_another_may_steer(node, keys):
    """Before the first key nothing is published either."""
    keys.repeat(STAMP, commanded())
    assert not node.published
    keys.press(UP, commanded())
    keys.press(steering.STOP, commanded())
    for velocity, count in ((0.01, 1), (0.01, 2), (0.0, 3), (0.0, 3)):
        keys.repeat(STAMP, commanded([velocity, 0.0, 0.0]))
        assert len(node.published) == count


@pytest.mark.parametrize(
    ("pressed", "pose"),
    [
        ("+", [0.062, 0.0, 0.0]),
        ("--", [0.056, 0.0, 0.0]),
        ("lli", [0.06, math.radians(2.0), math.radians(1.0)]),
        ("jk", [0.06, -math.radians(1.0), -math.radians(1.0)]),
    ],
)
def test_a_key_changes_height_and_attitude(node, keys, pressed, pose):
    for key in pressed:
        assert keys.press(key, commanded()).startswith("height ")
    assert isinstance(node.published[-1], PoseStamped)
    np.testing.assert_allclose(decode.body_pose(node.published[-1]), pose, atol=1e-9)


def test_a_pose_out_of_reach_is_refused_with_its_limit(node, keys):
    said = [keys.press("l", commanded()) for _ in range(40)]
    assert "reaches [" in said[-1]
    assert len(node.published) < 40


@pytest.mark.parametrize("key", [UP, "+", steering.STOP])
def test_without_a_gait_scheduler_the_line_says_so(node, keys, key):
    assert keys.press(key, None) == "no gait_scheduler answers"
    assert not node.published


def test_other_keys_and_those_of_requests_do_not_steer(keys):
    for key in (*operator_keys.KEYS, operator_keys.QUIT, "a", "\x1b", "\x1b[5~"):
        assert keys.press(key, commanded()) == ""


def test_keys_are_told_apart_in_what_a_terminal_sends():
    assert operator_keys.KEY.findall(f"w{UP}{LEFT}q\x1b[5~\x1bOA ") == [
        "w",
        UP,
        LEFT,
        "q",
        "\x1b[5~",
        "\x1bOA",
        " ",
    ]
