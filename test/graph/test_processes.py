"""Start and end of the graph: no process is left, and errors are named.

Processes end while the robot walks in lockstep, so that no time matters: a process that hangs is
ended by pytest's timeout.

Priority of the nodes' processes.

SIGINT and SIGTERM: node and listener end between two callbacks, a preparation at once.
"""

import ctypes
import math
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from itertools import product
from unittest.mock import Mock

import psutil
import pytest
from real_graph import nodes_of
from sensor_msgs.msg import JointState

from slot_bringup.monitor import listener
from slot_bringup.processes import command_line
from slot_core.config import ConfigError
from slot_nodes import qos, runtime
from slot_nodes.supervisor_node import NODES_PERIOD

# A run that does not end by itself.
RUN = [
    sys.executable,
    "-m",
    "slot_bringup",
    "--lockstep",
    "--duration",
    "600",
    "--bag",
    "bag",
]
ADOPTS = 36  # PR_SET_CHILD_SUBREAPER of prctl(2)


def start(cwd, composed=False):
    """Start a run of the graph; return its process and those of its nodes by name."""
    expected = set(nodes_of(bag="bag", lockstep=True, composed=composed))
    run = subprocess.Popen(
        [*RUN, "--composed" if composed else "--separate"],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    nodes = {}

    def all_started():
        assert run.poll() is None, run.communicate()
        for child in psutil.Process(run.pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                nodes.update(
                    {name: child for name in {child.name()} & expected}
                )
        return nodes.keys() == expected

    while not all_started():
        time.sleep(0.05)
    return run, nodes


def all_ended(nodes):
    return not any(
        psutil.pid_exists(node.pid) and node.is_running()
        for node in nodes.values()
    )


def wait_for_commands(run, count=30, seconds=0.0):
    """Wait until the graph has published commands, `count` or more, for a time: the robot walks."""
    received, end = [], time.monotonic() + seconds
    with listener("listener") as (node, executor):
        node.create_subscription(
            JointState, "desired_joint_angles", received.append, qos.CONTROL
        )
        while len(received) < count or time.monotonic() < end:
            executor.spin_once(timeout_sec=0.1)
            assert run.poll() is None, run.communicate()


@pytest.mark.parametrize(
    ("number", "composed"), [(signal.SIGINT, False), (signal.SIGTERM, True)]
)
def test_a_signal_stops_every_process_without_a_fault_and_keeps_the_bag(
    tmp_path, number, composed
):
    run, nodes = start(tmp_path, composed)
    wait_for_commands(run)
    run.send_signal(number)
    _, errors = run.communicate()
    assert run.returncode == 130, errors
    assert "scripts/run: interrupted, all nodes stopped" in errors
    assert "ended with exit code" not in errors  # of a node at its end
    assert all_ended(nodes)
    assert (tmp_path / "bag" / "metadata.yaml").exists()


@pytest.fixture
def adopting():
    """Processes whose parent ends become children of this one, which gets their exit codes."""
    prctl = ctypes.CDLL(None).prctl
    prctl(ADOPTS, 1)
    yield
    prctl(ADOPTS, 0)


@pytest.mark.usefixtures("adopting")
def test_every_node_ends_without_a_fault_by_sigterm_when_its_run_is_killed(
    tmp_path,
):
    """The kernel sends the signal, see slot_bringup.forked_node."""
    run, nodes = start(tmp_path)
    wait_for_commands(run)
    run.kill()
    run.communicate()
    assert {name: node.wait() for name, node in nodes.items()} == dict.fromkeys(
        nodes, 0
    )


def test_the_robot_walks_on_without_its_recorder_but_not_without_another_node_and_both_are_named(
    tmp_path,
):
    run, nodes = start(tmp_path)
    # the supervisor has seen the recorder
    wait_for_commands(run, seconds=4 * NODES_PERIOD)
    nodes["recorder"].kill()
    while "recorder" not in (line := run.stderr.readline()):
        pass
    said = "recorder ended with exit code -9: "
    assert said in line
    assert line.endswith("; the robot goes on without it\n")
    wait_for_commands(run)
    nodes["mpc_controller"].kill()
    summary, errors = run.communicate()
    assert run.returncode == 1
    assert said in summary
    assert "scripts/run: mpc_controller ended with exit code -9" in errors
    assert all_ended(nodes)


@pytest.mark.parametrize(
    ("name", "parameter", "message"),
    [
        ("mpc_controller", "stages:=fifteen", "stages"),
        ("mpc_controller", "policy:=cubic", "policy 'cubic': expected one of"),
        ("supervisor", "gait:=trot", "no gait 'trot' (known: "),
        ("sim_robot", "scene.solver.step:=1.0", "scene.solver.step"),
    ],
)
def test_invalid_parameter_is_refused_in_one_line(
    tmp_path, name, parameter, message
):
    command = [*command_line(nodes_of(bag="bag")[name]), "-p", parameter]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2, done.stderr
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr


def test_every_thread_takes_the_priority_and_who_has_no_right_to_it_is_told(
    monkeypatch,
):
    taken, ended = [], threading.Event()
    other = threading.Thread(target=ended.wait, daemon=True)
    other.start()
    monkeypatch.setattr(
        runtime.ctypes, "CDLL", lambda *_, **__: Mock(mlockall=lambda _: 0)
    )
    monkeypatch.setattr(
        runtime.os, "sched_setscheduler", lambda *values: taken.append(values)
    )
    runtime.take_priority("0")
    assert taken == []
    runtime.take_priority("20")
    assert {threading.get_native_id(), other.native_id} <= {
        thread for thread, _, _ in taken
    }
    runtime.take_priority("")  # nobody has asked for one: the default
    assert {(kind, given.sched_priority) for _, kind, given in taken} == {
        (os.SCHED_FIFO, 20),
        (os.SCHED_FIFO, runtime.PRIORITY),
    }
    monkeypatch.setattr(
        runtime.os, "sched_setscheduler", Mock(side_effect=PermissionError)
    )
    with pytest.raises(
        ConfigError, match=r"^realtime = 20: no right to this priority"
    ):
        runtime.take_priority("20")
    runtime.take_priority("")  # without the right to it
    ended.set()
    other.join()


@pytest.mark.parametrize(
    ("cores", "chosen", "priority"),
    [
        (2, {}, ""),  # that which the nodes may take
        (2, {"realtime": 0}, None),
        (2, {"lockstep": True}, None),
        (1, {}, None),
        (1, {"realtime": 20}, "20"),
    ],
)
def test_the_priority_that_nobody_has_asked_for(
    monkeypatch, cores, chosen, priority
):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(cores)))
    specs = nodes_of(**chosen).values()
    found = {spec.environment.get("SLOT_PRIORITY") for spec in specs}
    assert found - {None} == {priority} - {None}


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
        1 / (place != "fault")

    def close(self):
        print("closed", flush=True)

runtime.run(Interrupted)
"""


def run_node(number, place):
    """The ended process of a node that sends itself a signal at a place, or has a fault."""
    # a signal that the caller of the tests ignores (nohup) would be ignored here too
    program = ["env", "--default-signal=HUP", sys.executable, "-c", NODE]
    return subprocess.run(
        [*program, str(int(number)), place],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("number", "place"),
    [
        *product(
            (signal.SIGINT, signal.SIGTERM),
            ("make", "library", "import", "callback"),
        ),
        (signal.SIGHUP, "callback"),  # a lost connection to `ros2 launch`
    ],
)
def test_a_preparation_is_interrupted_at_once_and_a_callback_is_not(
    number, place
):
    """A node that sends itself the signal at that place ends without a fault."""
    ended = run_node(number, place)
    assert (ended.returncode, ended.stderr) == (0, "")
    printed = ["end of callback", "closed"] if place == "callback" else []
    assert ended.stdout.splitlines() == printed


def test_a_node_whose_callback_fails_is_closed_and_ends_with_exit_code_1():
    ended = run_node(signal.SIGTERM, "fault")
    assert (ended.returncode, ended.stdout) == (1, "closed\n")
    assert "ZeroDivisionError" in ended.stderr


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
