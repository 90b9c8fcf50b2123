"""Several nodes in one process: what ends the driver's thread ends the process."""

import subprocess
import sys

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
        self._nodes.append(node)
        self._driver = DirectExecutor()
        self._driver.add_node(node)

runtime.run(Broken, ComposedNodes.spin)
"""


def test_an_error_of_the_driver_ends_the_process_with_its_traceback():
    command = [sys.executable, "-c", BROKEN_DRIVER]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert ended.stderr.splitlines()[-1] == "RuntimeError: the bus is broken"
