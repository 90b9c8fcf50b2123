"""SIGINT and SIGTERM: node and listener end between two callbacks, a preparation at once."""

import math
import os
import signal
import subprocess
import sys

import pytest

from slot_bringup.monitor import listener

# Arguments: signal, where it is sent: in "make", in a "library" called by it, which drops the
# exception, in an "import", which makes another of it, as pybind does, or in a "callback".
NODE = """
import os, sys, time
from contextlib import suppress
import rclpy
from rclpy.node import Node
from slot_nodes import runtime

number, place = int(sys.argv[1]), sys.argv[2]

class Interrupted(Node):
    def __init__(self):
        super().__init__("interrupted")
        self.create_timer(0.01, self.work)
        with suppress(KeyboardInterrupt):
            self.raise_signal("library")
        if place == "library":
            time.sleep(100)
        try:
            self.raise_signal("import")
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error
        self.raise_signal("make")

    def raise_signal(self, here):
        if here == place:
            os.kill(os.getpid(), number)
            time.sleep(0.2)  # the context ends meanwhile
            print(f"end of {here}", flush=True)

    def work(self):
        self.raise_signal("callback")

    def close(self):
        print("closed", flush=True)

runtime.run(Interrupted)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("place", ["make", "library", "import", "callback"])
def test_a_preparation_is_interrupted_at_once_and_a_callback_is_not(
    number, place
):
    """A node that sends itself the signal at that place ends without a fault."""
    command = [sys.executable, "-c", NODE, str(int(number)), place]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    printed = ["end of callback", "closed"] if place == "callback" else []
    assert ended.stdout.splitlines() == printed


# Fast DDS waits for ever: a call into C that keeps Python's lock, as rclpy's does.
STUCK = """
import ctypes, sys
from slot_nodes.process import departure

print("finished")
with departure.limited(int(sys.argv[1]), limit=0.3):
    pass
with departure.limited(int(sys.argv[1]), limit=0.3):
    ctypes.PyDLL(None).sleep(100)
print("never")
"""


@pytest.mark.parametrize("code", [0, 1])
def test_a_process_whose_departure_from_dds_does_not_end_ends_with_its_exit_code(
    code,
):
    command = [sys.executable, "-c", STUCK, str(code)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (code, "")
    assert ended.stdout == "finished\n"


def test_a_program_that_listens_is_interrupted_between_two_callbacks():
    ended = []

    def interrupt_itself():
        os.kill(os.getpid(), signal.SIGINT)
        ended.append(True)

    with listener("listener") as (node, executor):
        node.create_timer(0.01, interrupt_itself)
        with pytest.raises(KeyboardInterrupt):
            executor.spin_until(lambda: False, math.inf)
    assert ended == [True]


def test_a_program_listens_until_its_condition_holds_or_its_time_is_over():
    ticks = []
    with listener("listener") as (node, executor):
        assert not executor.spin_until(lambda: False, 0.01)
        node.create_timer(0.01, lambda: ticks.append(True))
        assert executor.spin_until(lambda: len(ticks) == 3, math.inf)
    assert len(ticks) == 3
