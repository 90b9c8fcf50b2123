"""SIGINT and SIGTERM: a node ends between two callbacks, a preparation at once."""

import signal
import subprocess
import sys

import pytest

# Arguments: signal, where it is sent: in "make" or in a "callback", which also counts to its end.
NODE = """
import os, sys, time
import rclpy
from rclpy.node import Node
from slot_nodes import runtime

number, place = int(sys.argv[1]), sys.argv[2]

class Interrupted(Node):
    def __init__(self):
        super().__init__("interrupted")
        self.create_timer(0.01, self.work)
        self.raise_signal("make")

    def raise_signal(self, here):
        if here == place:
            os.kill(os.getpid(), number)
            time.sleep(0.2)  # the context ends meanwhile
            print(f"end of {here}", flush=True)

    def work(self):
        self.raise_signal("callback")

    def destroy_node(self):
        print("destroyed", flush=True)
        super().destroy_node()

runtime.run(Interrupted)
"""


def interrupted(number, place):
    """Output of a node that sends itself the signal at that place; it must end without a fault."""
    command = [sys.executable, "-c", NODE, str(int(number)), place]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (ended.returncode, ended.stderr) == (0, "")
    return ended.stdout.splitlines()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_callback_is_not_interrupted(number):
    assert interrupted(number, "callback") == ["end of callback", "destroyed"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_preparation_is_interrupted_at_once(number):
    assert interrupted(number, "make") == []
