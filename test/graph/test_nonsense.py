"""Invalid messages, suspended nodes and repeated signals: the graph continues or says why not."""

import copy
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
import rclpy
from geometry_msgs.msg import TwistStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import Imu, JointState

from slot_bringup import monitor
from slot_bringup.graph import read_graph
from slot_bringup.processes import Processes
from slot_core.robot import TENDON_JOINTS, read_robot
from slot_msgs.msg import GaitPreview, GroundReactionForces, MpcState
from slot_msgs.srv import SetGait
from slot_nodes import qos

TOPICS = {
    "odom": (Odometry, qos.SENSOR),
    "imu": (Imu, qos.SENSOR),
    "cmd_vel": (TwistStamped, qos.SENSOR),
    "mpc_state": (MpcState, qos.CONTROL),
    "gait_preview": (GaitPreview, qos.CONTROL),
    "ground_reaction_forces": (GroundReactionForces, qos.CONTROL),
    "desired_joint_angles": (JointState, qos.CONTROL),
    "joint_states": (JointState, qos.SENSOR),
}
NAN, INF = math.nan, math.inf
RUN = [sys.executable, "-m", "slot_bringup"]
TICKS = 15  # of the controller that must follow: half a second


class Graph:
    """A graph that walks in real time, and a node that records and sends messages."""

    def __init__(self, logs):
        graph = read_graph()
        self.processes = Processes(logs)
        self.processes.start(graph.nodes({a.name: a.default for a in graph.arguments}))
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.node = rclpy.create_node("intruder", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.last, self.commands = {}, []
        self.publishers = {}
        for topic, (kind, profile) in TOPICS.items():
            self.publishers[topic] = self.node.create_publisher(kind, topic, profile)
            self.node.create_subscription(kind, topic, self._keep(topic), profile)
        self.set_gait = self.node.create_client(SetGait, "set_gait")

    def _keep(self, topic):
        def keep(message):
            if message.header.frame_id == "intruder":
                return
            self.last[topic] = message
            if topic == "desired_joint_angles":
                self.commands.append(message)

        return keep

    def spin_until(self, condition, limit=30.0):
        end = time.monotonic() + limit
        while not condition():
            assert time.monotonic() < end, (self.processes.failed(), self.logs())
            self.executor.spin_once(timeout_sec=0.05)

    def continues(self):
        """Wait for TICKS commands newer than now; check the range of all commands."""
        begin = len(self.commands)
        newest = self.node.get_clock().now().nanoseconds * 1e-9
        self.spin_until(
            lambda: sum(seconds(m) > newest for m in self.commands[begin:]) >= TICKS,
        )
        assert self.processes.failed() is None
        limit = read_robot().tendon.angle_max
        for message in self.commands:
            assert tuple(message.name) == TENDON_JOINTS
            assert all(0.0 <= angle <= limit for angle in message.position)

    def send(self, topic, change=lambda m: None, shift=0.0):
        """Send a changed copy of the last message of a topic, its stamp shifted by `shift` (s)."""
        message = copy.deepcopy(self.last[topic])
        message.header.frame_id = "intruder"
        message.header.stamp.sec += int(shift)
        change(message)
        self.publishers[topic].publish(message)

    def disturb(self, topic, change):
        """Send an invalid copy, with the same stamp, after each of the next TICKS messages."""
        for _ in range(TICKS):
            before = self.last.get(topic)
            self.spin_until(lambda before=before: self.last.get(topic) is not before)
            self.send(topic, change)

    def request_gait(self, gait, *velocity):
        request = SetGait.Request(gait=gait)
        request.velocity = Vector3(**dict(zip("xyz", velocity)))
        answer = self.set_gait.call_async(request)
        self.spin_until(answer.done)
        return answer.result()

    def logs(self):
        return {p.stem: p.read_text() for p in self.processes.log_dir.glob("*.log")}

    def close(self):
        codes = self.processes.stop()
        self.node.destroy_node()
        self.context.try_shutdown()
        return codes


def seconds(message):
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    running = Graph(tmp_path_factory.mktemp("nonsense"))
    try:
        running.spin_until(lambda: len(running.commands) > TICKS, 90.0)
        yield running
    finally:
        codes = running.close()
    assert set(codes.values()) == {0}, (codes, running.logs())
    assert all("Traceback" not in log for log in running.logs().values())


def sets(**values):
    """Function that sets attributes of a message; `__` in a name stands for the dot."""

    def change(message):
        for name, value in values.items():
            *parents, last = name.split("__")
            part = message
            for parent in parents:
                part = getattr(part, parent)
            setattr(part, last, value)

    return change


@pytest.mark.parametrize(
    ("topic", "change"),
    [
        ("desired_joint_angles", sets(position=[NAN] * 4)),
        ("desired_joint_angles", sets(position=[INF] * 4)),
        ("desired_joint_angles", sets(position=[-0.1] * 4)),
        ("desired_joint_angles", sets(position=[1.0] * 3)),
        ("desired_joint_angles", sets(name=["a", "b", "c", "d"])),
        ("ground_reaction_forces", sets(force=[Vector3(z=NAN)] * 4)),
        ("ground_reaction_forces", sets(force=[Vector3(z=INF)] * 4)),
        ("gait_preview", sets(stages=0)),
        ("gait_preview", sets(stages=7)),
        ("gait_preview", sets(tendon_angle=[])),
        ("gait_preview", sets(tendon_angle=[1.0] * 16)),
        ("gait_preview", sets(tendon_angle=[NAN] * 64)),
        ("mpc_state", sets(position__x=NAN)),
        ("mpc_state", sets(rpy__x=INF, position__z=1e308)),
        ("odom", sets(pose__pose__position__x=NAN)),
        ("odom", sets(pose__pose__position__x=1e308)),
        ("odom", sets(pose__pose__orientation__w=0.0)),
        ("imu", sets(angular_velocity__x=NAN)),
    ],
)
def test_invalid_message_with_a_present_stamp_is_refused_and_the_robot_walks_on(
    graph, topic, change
):
    graph.disturb(topic, change)
    graph.continues()


@pytest.mark.parametrize("topic", ["odom", "imu", *list(TOPICS)[3:6]])
@pytest.mark.parametrize("shift", [1000.0, -1000.0])
def test_burst_of_messages_of_another_time_has_no_effect(graph, topic, shift):
    graph.spin_until(lambda: topic in graph.last)
    for i in range(40):
        graph.send(topic, shift=shift + i)
    graph.continues()


@pytest.mark.parametrize(
    ("topic", "change", "name", "line"),
    [
        ("ground_reaction_forces", sets(force=[Vector3(z=NAN)] * 4), "force_mapper",
         "ground_reaction_forces refused: force[0, 2] = nan: expected a finite number"),
        ("mpc_state", sets(position__x=NAN), "gait_scheduler",
         "mpc_state refused: state[3] = nan: expected a finite number"),
        ("desired_joint_angles", sets(position=[-0.1] * 4), "sim_robot",
         "desired_joint_angles refused: command FL = -0.1 rad is not inside [0, 2.029]"),
    ],
)  # fmt: skip
def test_refused_message_is_logged_with_value_and_limit(graph, topic, change, name, line):
    def refused():
        graph.send(topic, change)
        return line in graph.logs()[name]

    graph.spin_until(lambda: topic in graph.last)
    graph.spin_until(refused)


def test_unknown_gait_is_refused_and_the_last_of_many_changes_holds(graph):
    assert graph.request_gait("trot").message == "no gait 'trot' (known: stand, walk)"
    assert not graph.request_gait("walk", NAN).success
    assert not graph.request_gait("stand", 0.05).success
    for _ in range(10):
        assert graph.request_gait("stand").success
        assert graph.request_gait("walk", 0.05).success
    graph.spin_until(lambda: graph.last["gait_preview"].gait == "walk")
    graph.continues()


def test_velocity_of_another_time_stops_the_robot(graph):
    """A command with a stamp in the future sets the reference velocity to zero."""
    assert graph.request_gait("walk", 0.05).success
    graph.spin_until(lambda: graph.last["gait_preview"].reference[9] > 0.04)
    command = TwistStamped()
    command.header.stamp.sec = 2_000_000_000
    command.twist.linear.x = 0.05
    graph.publishers["cmd_vel"].publish(command)
    graph.spin_until(lambda: abs(graph.last["gait_preview"].reference[9]) < 0.03)
    graph.continues()
    assert "velocity set to zero" in graph.logs()["gait_scheduler"]


@pytest.mark.parametrize("name", ["sim_robot", "state_estimator", "mpc_controller"])
def test_suspended_node_catches_up(graph, name):
    os.kill(graph.processes.pid(name), signal.SIGSTOP)
    try:
        behind = time.monotonic() + 1.0
        graph.spin_until(lambda: time.monotonic() > behind)
    finally:
        os.kill(graph.processes.pid(name), signal.SIGCONT)
    graph.continues()


@pytest.mark.usefixtures("graph")
def test_second_graph_in_the_domain_is_refused(monkeypatch):
    monkeypatch.setattr(monitor, "DISCOVERY_TIME", 30.0)  # for a busy machine
    with pytest.raises(
        monitor.RunError, match=r"another graph runs in ROS domain \d+, namespace /: set another"
    ):
        monitor.require_no_other_graph()


def run(directory, *arguments, **environment):
    return subprocess.run(
        [*RUN, *arguments], cwd=directory, env=os.environ | environment, capture_output=True,
        text=True, timeout=60, check=False,
    )  # fmt: skip


@pytest.fixture
def own_domain(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(int(os.environ["ROS_DOMAIN_ID"]) + 20))


@pytest.mark.usefixtures("own_domain")
def test_bag_that_cannot_be_written_ends_the_run_in_one_line(tmp_path):
    (tmp_path / "file").touch()
    done = run(tmp_path, "--duration", "1", "--bag", "file/bag")
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert (
        "scripts/run: recorder ended with exit code 2: file/bag: cannot be written" in done.stderr
    )


@pytest.mark.usefixtures("own_domain")
def test_name_of_a_bag_may_contain_quotes_and_spaces(tmp_path):
    name = 'it\'s a "bag" of ü: 1'
    done = run(tmp_path, "--lockstep", "--duration", "0.5", "--bag", name)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / name / "metadata.yaml").exists()


@pytest.mark.usefixtures("own_domain")
@pytest.mark.parametrize("numbers", [[signal.SIGINT] * 3, [signal.SIGTERM] * 2, [signal.SIGHUP]])
def test_repeated_signals_end_the_run_cleanly(tmp_path, numbers):
    """The signals arrive while the nodes are still starting."""
    child = subprocess.Popen(
        [*RUN, "--bag", "bag"], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    ours = psutil.Process(child.pid)
    end = time.monotonic() + 30.0
    while not (nodes := [c for c in ours.children() if "slot_nodes" in " ".join(c.cmdline())]):
        assert time.monotonic() < end
        time.sleep(0.01)
    for number in numbers:
        child.send_signal(number)
        time.sleep(0.1)  # so that they are not merged into one
    _, errors = child.communicate(timeout=60)
    assert child.returncode == 130, errors
    assert "scripts/run: interrupted, all nodes stopped" in errors
    assert "Traceback" not in errors
    assert not any(node.is_running() for node in nodes)
    assert Path(tmp_path, "bag", "log").is_dir()
