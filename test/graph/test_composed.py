"""Processes of one node or several: an error of the driver ends all, no clock is changed."""

import subprocess
import sys

import pytest

BROKEN_DRIVER = """
from rclpy.node import Node
from slot_nodes import runtime
from slot_nodes.process.composed import ComposedNodes
from slot_nodes.process.executor import DirectExecutor

def fail():
    raise RuntimeError("the bus is broken")

class Broken(ComposedNodes):
    def __init__(self):
        super().__init__([])
        node = Node("broken_driver")
        node.create_timer(0.01, fail)
        self.nodes.append(node)
        self._driver = DirectExecutor()
        self._driver.add_node(node)

runtime.run(Broken, ComposedNodes.spin)
"""


def test_an_error_of_the_driver_ends_the_process_with_its_traceback():
    command = [sys.executable, "-c", BROKEN_DRIVER]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert ended.stderr.splitlines()[-1] == "RuntimeError: the bus is broken"


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
    ("how", "names"), [("alone", ["alone"]), ("composed", ["gait_scheduler", "force_mapper"])]
)
def test_the_clock_of_a_node_that_runs_cannot_be_changed(how, names):
    """By `ros2 param set`; rclpy itself would follow."""
    command = [sys.executable, "-c", FIXED_CLOCK, how]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.stdout.splitlines() == [f"{name} False False" for name in names], ended.stderr
