"""Motion and tendon angles of a bag are sound, or refused in one line."""

import numpy as np
import pytest
from synthetic_walk import message, write_messages

from slot_core.robot import TENDON_JOINTS
from slot_lab.bags.bag import Bag, BagError
from slot_lab.bags.recorded_walk import read_motion, tendon_angles

UNIT = (0.0, 0.0, 0.0, 1.0)


def odometry(stamp, x=0.0, quaternion=UNIT):
    fields = {"pose__pose__position": (x, 0, 0), "pose__pose__orientation": quaternion}
    return "/odom", message("/odom", stamp, **fields)


def joints(stamp, angle=1.0):
    built = message("/joint_states", stamp, position=[angle] * 4)
    built.name = list(TENDON_JOINTS)
    return "/joint_states", built


@pytest.fixture
def bag(tmp_path):
    """Writes a bag of (topic, message) and opens it."""

    def write(*entries):
        stamped = [(n, *entry) for n, entry in enumerate(entries)]
        return Bag(write_messages(tmp_path / "bag", stamped))

    return write


def test_equal_messages_of_one_stamp_count_once(bag):
    moved = read_motion(bag(odometry(1.0), odometry(1.0), odometry(2.0, 0.5)), "/odom")
    assert moved.t.tolist() == [1.0, 2.0]
    assert moved.position[:, 0].tolist() == [0.0, 0.5]


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ([(1.0, np.nan), (2.0, 0.0)], "message 0 holds a value that is not finite"),
        (
            [(1.0, 0.0), (3.0, 0.1), (2.5, 0.2)],
            "time goes back by 0.5 s after message 1",
        ),
        ([(1.0, 0.0), (1.0, 0.1)], "messages 0 and the next have one stamp"),
        ([(1.0, 0.0), (1.0, 0.0)], "1 samples, less than 2"),
        (
            [(1.0, 0.0), (2.0, 0.0, (0, 0, 0, 0.5))],
            "quaternion of sample 1 has the length 0.5",
        ),
        ([(1.0, 0.0), (2.0, 0.0, (0, 0, 0, 0))], "1 samples, less than 2"),
    ],
)
def test_an_odometry_that_is_not_sound_is_refused(bag, entries, message):
    with pytest.raises(BagError, match=message) as refusal:
        read_motion(bag(*(odometry(*entry) for entry in entries)), "/odom")
    assert "/odom: " in str(refusal.value)


def test_readings_that_say_that_they_are_lost_are_left_out_and_counted(bag):
    lost = (0.0, 0.0, 0.0, 0.0)
    moved = read_motion(
        bag(odometry(1.0), odometry(2.0, 0.0, lost), odometry(3.0, 0.5)), "/odom"
    )
    assert moved.t.tolist() == [1.0, 3.0]
    assert moved.left_out == 1


def test_of_two_states_of_one_time_the_second_counts(bag):
    states = [
        ("/mpc_state", message("/mpc_state", stamp, position__x=x, lead__nanosec=lead))
        for stamp, lead, x in (
            (1.0, 30_000_000, 0.1),
            (1.01, 20_000_000, 0.2),
            (1.1, 0, 0.3),
        )
    ]
    moved = read_motion(bag(*states), "/mpc_state")
    assert moved.t == pytest.approx([1.03, 1.1])
    assert moved.position[:, 0].tolist() == [0.2, 0.3]


def test_a_bag_without_tendon_angles_is_refused(bag):
    with pytest.raises(
        BagError, match="holds none of /joint_states, /desired_joint_angles"
    ):
        tendon_angles(bag(odometry(1.0), odometry(2.0)))


def test_measured_angles_go_before_commands(bag):
    angles = tendon_angles(bag(joints(1.0), joints(2.0, 1.5)))
    assert angles.measured
    assert angles.angle[:, 3].tolist() == [1.0, 1.5]


def test_joints_of_another_robot_are_refused(bag):
    """As many names as values, but twelve joints."""
    others = message("/joint_states", 1.0, position=[0.0] * 12)
    others.name = [f"joint_{n}" for n in range(12)]
    with pytest.raises(BagError, match="does not name each of FL_tendon"):
        tendon_angles(bag(("/joint_states", others), ("/joint_states", others)))
