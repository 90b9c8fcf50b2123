"""Processes of one node or several: no clock is changed."""

import subprocess
import sys

import pytest

FIXED_CLOCK = """
import sys
from rclpy.node import Node
from rclpy.parameter import Parameter
from slot_nodes import runtime
from slot_nodes.process.composed import ComposedNodes

def serve(made):
    for node in getattr(made, "nodes", [made]):
        answer = node.set_parameters_atomically([Parameter("use_sim_time", value=True)])
        print(node.get_name(), answer.successful, node.get_clock().ros_time_is_active)

composed = lambda: ComposedNodes(["gait_scheduler", "force_mapper"])
runtime.run(composed if "composed" in sys.argv else lambda: Node("alone"), serve)
"""


@pytest.mark.parametrize(
    ("how", "names"),
    [("alone", ["alone"]), ("composed", ["gait_scheduler", "force_mapper"])],
)
def test_the_clock_of_a_node_that_runs_cannot_be_changed(how, names):
    """By `ros2 param set`; rclpy itself would follow."""
    command = [sys.executable, "-c", FIXED_CLOCK, how]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.stdout.splitlines() == [
        f"{name} False False" for name in names
    ], ended.stderr
