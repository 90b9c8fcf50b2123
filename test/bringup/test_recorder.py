"""The recorder as a process: nothing is lost at its end, and little when it is killed."""

import signal
import subprocess
import time
from contextlib import suppress

import pytest
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rig import nodes_of

from slot_bringup.monitor import listener
from slot_bringup.processes import command_line
from slot_core.recording.record_settings import BagError
from slot_lab.bags.bag import Bag
from slot_nodes import qos

SET = {"scene": "slope5", "namespace": "recorded"}
LEAST = 50  # messages on disk before the recorder is ended


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_recorder_that_ends_loses_nothing_and_a_killed_one_the_last_moment(
    tmp_path, number
):
    path = tmp_path / "bag"
    recorder = nodes_of(**SET, bag=str(path))["recorder"]
    process = subprocess.Popen(command_line(recorder))
    count, left = 0, []
    with listener("robot", "recorded") as (node, _):
        publisher = node.create_publisher(Odometry, "odom", qos.SENSOR)
        while not publisher.get_subscription_count():
            time.sleep(0.02)
        while len(left) < LEAST:
            publisher.publish(Odometry(child_frame_id=str(count)))
            count += 1
            time.sleep(0.005)
            if count % LEAST == 0:
                with suppress(BagError):
                    left = frames(Bag(path, "recorded"))
        assert publisher.wait_for_all_acked(Duration(seconds=60))
        process.send_signal(number)
        code = process.wait()
    bag, told = Bag(path, "recorded"), number == signal.SIGTERM
    left = frames(bag)
    assert (code, bag.finished) == (0 if told else -number, told)
    assert left == [str(n) for n in range(count if told else len(left))]
    assert len(left) >= LEAST
    about = bag.origin.about
    assert about.pop("revision")
    assert about == {"hardware": "sim", "gait": "walk"} | SET


def frames(bag):
    return [message.child_frame_id for _, message in bag.messages("/odom")]
