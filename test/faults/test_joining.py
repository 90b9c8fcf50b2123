"""DDS participants that join and leave, as `ros2 topic echo` does, leave a walking robot alone.

Real time: what DDS does in other processes when a participant joins.
"""

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from real_graph import PATIENT
from rig import TOPICS

from slot_core.safety.states import State

pytestmark = pytest.mark.real_time

ROUNDS, TOGETHER = 5, 4  # participants that join at the same time, so that it takes a quarter
HEARD = {"/odom", "/desired_joint_angles"}  # of two nodes
# s; below the 0.333 s for which Fast DDS sleeps where it opens a port of shared memory
HOLD = 0.25
CONFIG = {**PATIENT, "supervisor": PATIENT["supervisor"] | {"timing.command_hold": HOLD}}


class PasserBy:
    """A participant that has received a message of every topic HEARD before it leaves."""

    def __init__(self):
        self.context, self.heard = Context(), set()
        rclpy.init(args=[], context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node("passer_by", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(node)
        for topic in HEARD:
            kind, profile = TOPICS[topic]
            node.create_subscription(kind, topic, lambda _, t=topic: self.heard.add(t), profile)

    def leave(self):
        self.executor.shutdown()
        self.context.try_shutdown()


def join_and_leave():
    """Take part in the graph, several at once, until each has received its messages."""
    present = [PasserBy() for _ in range(TOGETHER)]
    while any(one.heard != HEARD for one in present):
        for one in present:
            one.executor.spin_once(timeout_sec=0.01)
    for one in present:
        one.leave()


def test_participants_that_join_and_leave_do_not_stop_a_walking_robot(make_rig):
    rig = make_rig(hardware="sim", config=CONFIG)
    rig.walk_steadily()
    walking = rig.transitions[-1]
    for _ in range(ROUNDS):
        join_and_leave()
    assert rig.transitions[-1] == walking, rig.recent_events()
    assert rig.state is State.WALKING
