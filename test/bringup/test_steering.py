"""Keys that steer the robot, and what they publish."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped

from slot_bringup import operator_screen, steering
from slot_core.messages import decode
from slot_msgs.msg import GaitPreview

UP, DOWN, RIGHT, LEFT = (f"\x1b[{letter}" for letter in "ABCD")
STAMP = 7_000_000_000


class Keys(steering.SteeringKeys):
    """Keys that keep what they publish, in a graph that hears one type of /cmd_vel."""

    def __init__(self, heard="TwistStamped"):
        self.published = []
        topic = SimpleNamespace(publish=self.published.append)
        info = SimpleNamespace(topic_type=f"geometry_msgs/msg/{heard}")
        node = {"create_publisher": lambda *_: topic}
        node["get_subscriptions_info_by_topic"] = lambda _: [info]
        super().__init__(SimpleNamespace(**node))


def commanded(velocity=(0.0, 0.0, 0.0), gait="walk"):
    return GaitPreview(
        requested=gait, velocity=list(velocity), pose=[0.06, 0.0, 0.0]
    )


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
    keys = Keys(heard.__name__)
    for key in pressed:
        assert keys.press(key, commanded()).startswith("velocity ")
    keys.repeat(STAMP, commanded())
    (message,) = keys.published
    assert type(message) is heard
    stamp, sent = decode.velocity(message)
    assert stamp == (STAMP if heard is TwistStamped else 0)
    np.testing.assert_allclose(sent, velocity, atol=1e-15)


def test_a_velocity_beyond_the_reach_of_the_gait_is_clipped_and_does_not_wind_up():
    """The first key goes on from what is commanded."""
    keys, present = Keys(), commanded([0.03, 0.0, 0.0])
    keys.press(UP, present)
    keys.repeat(STAMP, present)
    assert decode.velocity(keys.published[0])[1] == pytest.approx(
        [0.04, 0.0, 0.0]
    )
    said = [keys.press(UP, present) for _ in range(20)]
    assert said[-1].startswith("velocity clipped to the reach of gait walk")
    keys.press(DOWN, present)
    keys.repeat(STAMP, present)
    assert decode.velocity(keys.published[1])[1][0] < 0.1  # not 0.19


def test_zero_is_repeated_until_it_is_commanded_then_another_may_steer():
    """Before the first key nothing is published either."""
    keys = Keys()
    keys.repeat(STAMP, commanded())
    assert not keys.published
    keys.press(UP, commanded())
    keys.press(steering.STOP, commanded())
    for velocity, count in ((0.01, 1), (0.01, 2), (0.0, 3), (0.0, 3)):
        keys.repeat(STAMP, commanded([velocity, 0.0, 0.0]))
        assert len(keys.published) == count


@pytest.mark.parametrize(
    ("pressed", "pose"),
    [
        ("+", [0.062, 0.0, 0.0]),
        ("--", [0.056, 0.0, 0.0]),
        ("lli", [0.06, math.radians(2.0), math.radians(1.0)]),
        ("jk", [0.06, -math.radians(1.0), -math.radians(1.0)]),
    ],
)
def test_a_key_changes_height_and_attitude_up_to_a_limit(pressed, pose):
    keys = Keys()
    for key in pressed:
        assert keys.press(key, commanded()).startswith("height ")
    assert isinstance(keys.published[-1], PoseStamped)
    np.testing.assert_allclose(
        decode.body_pose(keys.published[-1]), pose, atol=1e-9
    )
    said = [keys.press(pressed[-1], commanded()) for _ in range(40)]
    assert "reaches [" in said[-1]
    assert len(keys.published) < 40


def test_other_keys_do_not_steer_nor_any_without_a_gait_scheduler():
    keys = Keys()
    for key in (
        *operator_screen.KEYS,
        operator_screen.QUIT,
        "a",
        "\x1b",
        "\x1b[5~",
    ):
        assert keys.press(key, commanded()) == ""
    for key in (UP, "+", steering.STOP):
        assert keys.press(key, None) == "no gait_scheduler answers"
    assert not keys.published


def test_keys_are_told_apart_in_what_a_terminal_sends():
    sent = ["w", UP, LEFT, "q", "\x1b[5~", "\x1bOA", " "]
    assert operator_screen.KEY.findall("".join(sent)) == sent
