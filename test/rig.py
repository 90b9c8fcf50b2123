"""The running graph under test: processes, their messages and services, faults, recovery."""

import os
import signal
import subprocess
import time
from collections import defaultdict

import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions
from real_graph import PATIENT, changed_config
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from slot_bringup.graph import TIED, read_graph
from slot_bringup.processes import command_line
from slot_core.config import build
from slot_core.dynamixel.bus import Bus
from slot_core.dynamixel.port import SerialPort
from slot_core.dynamixel.settings import read_settings
from slot_core.messages import decode
from slot_core.safety.settings import SupervisorSettings
from slot_core.safety.states import State
from slot_msgs.msg import LegStates, RobotState, ServoHealth
from slot_msgs.srv import InjectFault
from slot_nodes import qos
from slot_nodes.process.executor import DirectExecutor

WAIT_LIMIT = 60.0  # s, of any wait on a busy machine
TOPICS = {
    "/robot_state": (RobotState, qos.STATE),
    "/servo_health": (ServoHealth, qos.SENSOR),
    "/diagnostics": (DiagnosticArray, qos.SENSOR),
    "/joint_states": (JointState, qos.SENSOR),
    "/desired_joint_angles": (JointState, qos.CONTROL),
    "/odom": (Odometry, qos.SENSOR),
    "/ground_truth/odom": (Odometry, qos.SENSOR),
    "/ground_truth/legs": (LegStates, qos.SENSOR),
}
# Request that leads towards WALKING, by state.
NEXT_REQUEST = {
    State.ESTOP: "reset",
    State.FAULT: "reset",
    State.IDLE: "ready",
    State.READY: "stand",
    State.STANDING: "walk",
}


def nodes_of(**changes):
    """Nodes of the graph by name, with changed values of its arguments."""
    graph = read_graph()
    values = {a.name: a.default for a in graph.arguments} | changes
    return {spec.name: spec for spec in graph.nodes(values)}


class Rig:
    """A graph with its messages, requests and faults. Times are ns of the messages' clock."""

    def __init__(
        self, directory, config=PATIENT, parameters=None, only=None, **arguments
    ):
        """`config`: as for `changed_config`; `parameters`: by node; `only`: nodes to
        start now, else all; `arguments`: of the graph."""
        self.directory, self.bus = directory, directory / "bus"
        self.config = changed_config(directory, config)
        self._parameters = parameters or {}
        values = {"hardware": "fake_bus"} | arguments
        if values["hardware"] == "fake_bus":
            values["port"] = str(self.bus)
        self.specs = nodes_of(**values)
        self.children = {}
        self.messages = defaultdict(list)
        self.transitions = []  # (since, State, reason)
        self._clients = {}
        self._open_node()
        self.start(*(self.specs if only is None else only))

    def _open_node(self, executor=DirectExecutor):
        """Make the node of the test, and subscribe to TOPICS."""
        self.context = Context()
        no_handlers = SignalHandlerOptions.NO
        rclpy.init(
            args=[], context=self.context, signal_handler_options=no_handlers
        )
        self.node = rclpy.create_node("tester", context=self.context)
        self._executor = executor(context=self.context)
        self._executor.add_node(self.node)
        for topic, (kind, profile) in TOPICS.items():
            self.subscribe(topic, kind, profile)
        self.node.create_subscription(
            RobotState, "/robot_state", self._on_state, qos.STATE
        )

    def subscribe(self, topic, kind, profile):
        """Keep the messages of a topic."""
        self.node.create_subscription(
            kind, topic, self.messages[topic].append, profile
        )

    def publisher(self, kind, topic, profile):
        return self.node.create_publisher(kind, topic, profile)

    def every(self, period, action):
        """Call a function of the test with a period, s; returns a timer with `cancel`."""
        return self.node.create_timer(period, action)

    def run(self, seconds):
        """Let the graph run, and receive its messages."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(left)

    def _on_state(self, message):
        now = (decode.time(message.since), State(message.state), message.reason)
        if not self.transitions or self.transitions[-1] != now:
            self.transitions.append(now)

    def start(self, *names, parameters=None, program=()):
        """Start nodes, also again; `parameters` and another `program` for this start only."""
        for name in names:
            executable, *arguments = command_line(self.specs[name])
            values = {**self._parameters.get(name, {}), **(parameters or {})}
            options = [
                w
                for key, value in values.items()
                for w in ("-p", f"{key}:={value}")
            ]
            self.spawn(name, [*(program or [executable]), *arguments, *options])

    def spawn(self, name, command):
        """Start a process; its output is the log of that name."""
        environment = os.environ | {"SLOT_CONFIG": str(self.config)}
        with (self.directory / f"{name}.log").open("ab") as log:
            self.children[name] = subprocess.Popen(
                [*TIED, *command],
                env=environment,
                stdout=log,
                stderr=log,
                start_new_session=True,
                cwd=self.directory,
            )

    def log(self, name):
        """Output of a node so far."""
        log = self.directory / f"{name}.log"
        return log.read_text(errors="replace") if log.exists() else ""

    def log_lines(self, name):
        """Output of a node so far, by lines."""
        return self.log(name).splitlines()

    def runs(self, name):
        return name in self.children and self.children[name].poll() is None

    def exit_code(self, name):
        """Exit code of a node; waits until it ends by itself."""
        self.wait_for(lambda: not self.runs(name), what=f"{name} does not end")
        return self.children[name].returncode

    def now(self):
        """Present time of the messages' clock."""
        return time.time_ns()

    def wait_for(self, condition, limit=WAIT_LIMIT, what="condition not met"):
        """Wait until a condition is true, at most `limit` s; returns its value."""
        end = self.now() + limit * 1e9
        while not (value := condition()):
            assert self.now() < end, f"{what}: {self.recent_events()}"
            self.run(0.01)
        return value

    def recent_events(self):
        """Last transitions and the ends of all logs, for the message of a failure."""
        logs = [f"{name}:\n{self.log(name)[-2000:]}" for name in self.specs]
        return "\n".join([*map(str, self.transitions[-12:]), *logs])

    def call(self, kind, service, /, **request):
        """Call a service; returns its answer."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
        client = self._clients[service]
        self.wait_for(client.service_is_ready, what=f"no service {service}")
        answer = client.call_async(kind.Request(**request))
        self.wait_for(answer.done, what=f"no answer of {service}")
        return answer.result()

    def request(self, name):
        """Make a request to the supervisor; returns why it is refused, or ""."""
        return self.call(Trigger, f"/supervisor/{name}").message

    def inject(self, kind, leg="all", clear=False, **values):
        """Inject a fault into the simulated robot, or clear it; returns the time before it."""
        now = self.now()
        answer = self.call(
            InjectFault,
            "/sim_robot/inject",
            kind=kind,
            leg=leg,
            clear=clear,
            **values,
        )
        assert answer.success, answer.message
        return now

    @property
    def state(self):
        """State of the supervisor in its newest message; None without one."""
        return self.transitions[-1][1] if self.transitions else None

    def last(self, topic):
        return self.messages[topic][-1]

    def since(self, topic, time):
        """Messages of a topic stamped at or after a time."""
        return [
            message
            for message in list(self.messages[topic])
            if decode.stamp(message) >= time
        ]

    def supervisor_settings(self):
        """Settings of supervisor.yaml in force."""
        values = yaml.safe_load((self.config / "supervisor.yaml").read_text())
        return build(SupervisorSettings, values, "supervisor.yaml")

    def wait_for_state(self, state, time, limit=WAIT_LIMIT):
        """Wait for a transition to `state` at or after `time`; returns (since, reason)."""

        def found():
            later = (
                t
                for t in list(self.transitions)
                if t[0] >= time and t[1] is state
            )
            return next(((since, reason) for since, _, reason in later), None)

        return self.wait_for(found, limit, f"never {state.name}")

    def wait_for_torque_off(self, time):
        """Wait for a health report since `time` with every torque off; returns the first."""
        found = self.wait_for(
            lambda: [
                m
                for m in self.since("/servo_health", time)
                if not any(m.torque)
            ],
            what="torque stays on",
        )
        return found[0]

    def registers(self, name):
        """A register of every servo; the driver must have ended."""
        settings = read_settings()
        port = SerialPort(str(self.bus), settings.bus.baud, 0.5)
        port.open()
        try:
            bus = Bus(port, settings.bus)
            return [
                bus.read(identity, name)[name]
                for identity in settings.joints.ids
            ]
        finally:
            port.close()

    def walk(self):
        """Bring the robot to WALKING from any state, by the requests of an operator."""
        end = self.now() + WAIT_LIMIT * 1e9
        refusal = ""
        while self.state is not State.WALKING:
            assert self.now() < end, f"{refusal}: {self.recent_events()}"
            if self.state in NEXT_REQUEST:
                refusal = self.request(NEXT_REQUEST[self.state])
            self.run(0.05)

    def stop(self, name):
        """Interrupt a node unless it has ended; returns its exit code."""
        if self.runs(name):
            self.children[name].send_signal(signal.SIGINT)
        return self.exit_code(name)

    def walk_steadily(self):
        """Bring the robot to WALKING, and wait until it has walked for half a second."""
        while (
            self.state is not State.WALKING
            or self.now() - self.transitions[-1][0] < 5e8
        ):
            self.walk()
            self.run(0.05)

    def close(self):
        """End every node; returns the exit codes."""
        for child in self.children.values():
            if child.poll() is None:
                child.send_signal(signal.SIGINT)
        for child in self.children.values():
            try:
                child.wait(10)
            except subprocess.TimeoutExpired:
                os.killpg(child.pid, signal.SIGKILL)
                child.wait()
        self.context.try_shutdown()
        return {name: child.returncode for name, child in self.children.items()}


def maker(kind):
    """A fixture: a function that makes rigs of a kind; their nodes end with the module."""

    @pytest.fixture(scope="module")
    def make_rig(tmp_path_factory):
        made = []

        def make(**options):
            made.append(kind(tmp_path_factory.mktemp("rig"), **options))
            return made[-1]

        yield make
        for rig in made:
            rig.close()

    return make_rig
