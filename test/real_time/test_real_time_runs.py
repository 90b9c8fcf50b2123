"""Runs at the pace of the wall clock: scripts/run, the real driver, participants that join."""

import math
import subprocess
import sys
import time
from argparse import Namespace
from contextlib import suppress

import pytest
from nav_msgs.msg import Odometry
from real_graph import nodes_of
from sensor_msgs.msg import JointState

from slot_bringup.monitor import listener
from slot_bringup.operate import OperateError, call, service
from slot_bringup.processes import Processes
from slot_core.safety.states import State
from slot_lab.bags.bag import Bag
from slot_lab.bags.check_bag import check_bag
from slot_nodes import qos

pytestmark = pytest.mark.real_time

RUN = [sys.executable, "-m", "slot_bringup"]
JOINS = 5
CONFIRMED = "torque off, confirmed by every servo"
OUTPUTS = [
    "/mpc_state",
    "/gait_preview",
    "/tendon_plan",
    "/desired_joint_angles",
]
# s of walking; at least so many ticks are compared, of 30 a second
WALK, TICKS = (2.0, 30)


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


def join_and_leave(graph):
    """Take part in a graph until messages of two nodes have come; whether they have."""
    heard = []
    with listener("passer_by") as (node, executor):
        for topic, kind, profile in (
            ("/odom", Odometry, qos.SENSOR),
            ("/desired_joint_angles", JointState, qos.CONTROL),
        ):
            heard.append([])
            node.create_subscription(kind, topic, heard[-1].append, profile)
        executor.spin_until(
            lambda: all(heard) or graph.poll() is not None, math.inf
        )
    return all(heard)


@pytest.fixture(scope="module")
def walked(environment, tmp_path_factory):
    """Bag of a run on the real driver, at a pseudo-terminal, while participants come and go."""
    bag, joined = tmp_path_factory.mktemp("run") / "bag", 0
    options = ["--hardware", "fake_bus", "--duration", "12", "--bag", str(bag)]
    graph = subprocess.Popen([*RUN, *options], env=environment)
    while graph.poll() is None:
        joined += join_and_leave(graph)
    assert graph.returncode == 0
    assert joined >= JOINS
    return bag


def test_robot_walks_with_the_real_driver_which_leaves_no_torque(walked):
    """Measured: 44 mm/s on average; half of it shows that it walks."""
    place = Bag(walked).series("/ground_truth/odom", "pose.pose.position")
    x, seconds = place["pose.pose.position"][:, 0], place.stamp * 1e-9
    assert (x[-1] - x[0]) / (seconds[-1] - seconds[0]) > 0.02
    log = walked / "log"
    assert CONFIRMED in (log / "dynamixel_driver.log").read_text()
    left = "servos left under torque: none"
    assert left in (log / "sim_robot.log").read_text()


def test_participants_that_join_and_leave_do_not_stop_a_walking_robot(walked):
    """As `ros2 topic echo` does; what DDS does in other processes takes real time."""
    states = Bag(walked).series("/robot_state", "state")["state"]
    begin = list(states).index(State.WALKING)
    assert set(states[begin:]) == {State.WALKING}


def granted(request):
    """Whether the supervisor is there and grants a request."""
    with suppress(OperateError):
        return call(service(Namespace(action=request)), "")[0]
    return False


def test_a_bag_of_a_real_robot_replays_to_the_last_bit(environment, tmp_path):
    """The robot, simulated, is a process of its own at a pseudo-terminal, there before the graph."""
    port, bag = tmp_path / "servos", tmp_path / "bag"
    robot = nodes_of(hardware="fake_bus", port=str(port))["sim_robot"]
    graph = nodes_of(hardware="real", port=str(port), bag=str(bag))
    graph["supervisor"].parameters["estop_required"] = False
    processes = Processes(tmp_path / "log", environment)
    try:
        processes.start([robot])
        while not port.exists():
            time.sleep(0.05)
        processes.start(graph.values())
        for request in ("ready", "stand", "walk"):
            while not granted(request):
                time.sleep(0.1)
        time.sleep(WALK)
        assert processes.failed() is None
    finally:
        processes.stop(last="recorder")
    comparisons = check_bag(Bag(bag), 0.0)
    assert [c.topic for c in comparisons] == OUTPUTS
    for comparison in comparisons:
        line = str(comparison)
        assert not comparison.why, line
        assert comparison.first is None, comparison.first
        assert comparison.largest == 0.0, line
        assert comparison.compared >= TICKS, line
