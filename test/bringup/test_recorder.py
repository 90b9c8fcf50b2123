"""The recorder as a process: nothing is lost at its end, and little when it is killed."""

import signal
import subprocess
import time

from nav_msgs.msg import Odometry
from rclpy.duration import Duration

from slot_bringup.graph import read_graph
from slot_bringup.monitor import listener
from slot_bringup.processes import command_line
from slot_core.recording.bag_error import BagError
from slot_lab.bags.bag import Bag
from slot_nodes import qos

SET = {"scene": "slope5", "namespace": "recorded"}
LEAST = 50  # messages on disk before the recorder is ended


def record(path, number):
    """Record odometry in a process, end it by a signal; return its exit code and what was sent."""
    graph = read_graph()
    values = {a.name: a.default for a in graph.arguments} | SET | {"bag": str(path)}
    recorder = next(spec for spec in graph.nodes(values) if spec.name == "recorder")
    process = subprocess.Popen(command_line(recorder))
    with listener("robot", "recorded") as (node, _):
        publisher = node.create_publisher(Odometry, "odom", qos.SENSOR)
        while not publisher.get_subscription_count():
            assert process.poll() is None
            time.sleep(0.02)
        count = 0
        while count % LEAST or not written(path, LEAST):
            assert process.poll() is None
            publisher.publish(Odometry(child_frame_id=str(count)))
            count += 1
            time.sleep(0.005)
        assert publisher.wait_for_all_acked(Duration(seconds=60))
        process.send_signal(number)
        code = process.wait()
    return code, [str(n) for n in range(count)]


def written(path, least):
    """Whether a bag that is being recorded has that many messages on disk."""
    try:
        return len(frames(Bag(path, "recorded"))) >= least
    except BagError:
        return False


def frames(bag):
    return [message.child_frame_id for _, message in bag.messages("/odom")]


def test_a_killed_recorder_leaves_all_but_the_last_moment(tmp_path):
    _, published = record(tmp_path / "bag", signal.SIGKILL)
    bag = Bag(tmp_path / "bag", "recorded")
    left = frames(bag)
    assert not bag.finished
    assert left == published[: len(left)]
    assert len(left) >= LEAST
    about = bag.origin.about
    assert about.pop("revision")
    assert about == {"hardware": "sim", "gait": "walk"} | SET


def test_a_recorder_that_is_told_to_end_loses_nothing(tmp_path):
    code, published = record(tmp_path / "bag", signal.SIGTERM)
    bag = Bag(tmp_path / "bag", "recorded")
    assert code == 0
    assert bag.finished
    assert frames(bag) == published
