"""Runs at the pace of the wall clock: scripts/run, the real driver, participants that join."""

import subprocess
import sys

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rig import TOPICS

from slot_core.safety.states import State
from slot_lab.bags.bag import Bag

pytestmark = pytest.mark.real_time

RUN = [sys.executable, "-m", "slot_bringup"]
JOINS = 10
HEARD = {"/odom", "/desired_joint_angles"}  # of two nodes


def run(*arguments, **options):
    """Output of a run; it must succeed."""
    done = subprocess.run(
        [*RUN, *arguments],
        capture_output=True,
        text=True,
        check=False,
        **options,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_run_in_real_time_keeps_its_pace_and_prints_a_summary(tmp_path):
    output = run("--duration", "4", "--no-bag", cwd=tmp_path)
    figures = dict(
        line.split(maxsplit=1) for line in output.splitlines() if line.strip()
    )
    assert float(figures["real-time"].split()[-1]) == pytest.approx(
        1.0, abs=0.1
    )
    assert list(tmp_path.iterdir()) == []


def test_robot_walks_with_the_real_driver_which_leaves_no_torque(
    environment, tmp_path
):
    """At a pseudo-terminal. Measured: 44 mm/s on average; half of it shows that it walks."""
    bag = tmp_path / "bag"
    run(
        "--hardware",
        "fake_bus",
        "--duration",
        "5",
        "--bag",
        str(bag),
        env=environment,
    )
    place = Bag(bag).series("/ground_truth/odom", "pose.pose.position")
    walked = place["pose.pose.position"][:, 0]
    assert (walked[-1] - walked[0]) / (
        place.stamp[-1] - place.stamp[0]
    ) * 1e9 > 0.02
    assert (
        "torque off, confirmed by every servo"
        in (bag / "log/dynamixel_driver.log").read_text()
    )
    assert (
        "servos left under torque: none"
        in (bag / "log/sim_robot.log").read_text()
    )


def join_and_leave():
    """Take part in the graph until a message of every topic HEARD has come."""
    context = Context()
    rclpy.init(
        args=[], context=context, signal_handler_options=SignalHandlerOptions.NO
    )
    executor = SingleThreadedExecutor(context=context)
    try:
        node = rclpy.create_node("passer_by", context=context)
        executor.add_node(node)
        heard = set()
        for topic in HEARD:
            kind, profile = TOPICS[topic]
            node.create_subscription(
                kind, topic, lambda _, t=topic: heard.add(t), profile
            )
        while heard != HEARD:
            executor.spin_once()
    finally:
        executor.shutdown()
        context.try_shutdown()


def test_participants_that_join_and_leave_do_not_stop_a_walking_robot(make_rig):
    """As `ros2 topic echo` does; what DDS does in other processes takes real time."""
    rig = make_rig(hardware="sim")
    rig.walk_steadily()
    walking = rig.transitions[-1]
    for _ in range(JOINS):
        join_and_leave()
    assert rig.transitions[-1] == walking, rig.recent_events()
    assert rig.state is State.WALKING
