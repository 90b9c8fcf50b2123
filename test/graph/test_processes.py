"""Start and end of the graph: no process is left, and errors are named.

Processes end while the robot walks in lockstep, so that no time matters: a process that hangs is
ended by pytest's timeout.
"""

import ctypes
import signal
import subprocess
import sys
import time
from contextlib import suppress

import psutil
import pytest
from rig import nodes_of
from sensor_msgs.msg import JointState

from slot_bringup.monitor import listener
from slot_bringup.processes import command_line
from slot_nodes import qos
from slot_nodes.supervisor_node import NODES_PERIOD

NODES = nodes_of(bag="bag")
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


def test_an_interrupt_stops_every_process_without_a_fault_and_keeps_the_bag(
    tmp_path,
):
    run, nodes = start(tmp_path)
    wait_for_commands(run)
    assert_interrupted(run, nodes, tmp_path, signal.SIGINT)


def test_sigterm_stops_every_process_and_keeps_the_bag(tmp_path):
    run, nodes = start(tmp_path, composed=True)
    wait_for_commands(run)
    assert_interrupted(run, nodes, tmp_path, signal.SIGTERM)


def assert_interrupted(run, nodes, directory, number):
    run.send_signal(number)
    _, errors = run.communicate()
    assert run.returncode == 130, errors
    assert "scripts/run: interrupted, all nodes stopped" in errors
    assert "ended with exit code" not in errors  # of a node at its end
    assert all_ended(nodes)
    assert (directory / "bag" / "metadata.yaml").exists()


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


def test_a_second_publisher_of_the_commands_ends_the_run_and_is_named(tmp_path):
    """It need not send anything: DDS says that it is there."""
    run, nodes = start(tmp_path, composed=True)
    wait_for_commands(run)
    with listener("intruder") as (node, _):
        node.create_publisher(JointState, "desired_joint_angles", qos.CONTROL)
        _, errors = run.communicate()
    assert run.returncode == 1
    assert (
        "/desired_joint_angles has 2 publishers, limit 1: /force_mapper, "
        in errors
    )
    assert all_ended(nodes)


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
    command = [*command_line(NODES[name]), "-p", parameter]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2, done.stderr
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
