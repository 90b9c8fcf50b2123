"""A graph of processes to be harmed: started, heard, asked, and brought back to walking."""

import contextlib
import os
import signal
import subprocess
import threading
import time
from collections import defaultdict

import numpy as np
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from real_graph import changed_config
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from slot_bringup.graph import read_graph
from slot_bringup.processes import command_line, die_with_parent
from slot_core.bags import decode
from slot_core.config import build
from slot_core.dynamixel.bus import Bus
from slot_core.dynamixel.port import SerialPort
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.safety.settings import SupervisorSettings
from slot_core.safety.states import State
from slot_msgs.msg import LegStates, RobotState, ServoHealth
from slot_msgs.srv import InjectFault
from slot_nodes import qos

PATIENCE = 60.0  # s that anything may take on a busy machine
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
# What leads towards WALKING from the states in which somebody has to ask.
NEXT = {
    State.ESTOP: "reset", State.FAULT: "reset",
    State.IDLE: "ready", State.READY: "stand", State.STANDING: "walk",
}  # fmt: skip
# s, from a limit to the reaction: two periods of the supervisor (20 ms) or of a bus cycle, and how
# long a busy machine lets a process wait.
LATE = 0.5
# counts that a servo gives way by where torque comes on: until then the friction of its gearbox has
# held up to 0.1 of the stall torque (emulator.yaml), now a loop of p/128 of 885 steps a count does.
SAG = 1 + 0.1 * 885 * 128 / read_settings().gains.p
RAMP = 1.2  # s, the longest way to slack: relax_time of supervisor.yaml
# A busy machine keeps processes waiting for longer than a robot may: limits that it keeps. What is
# promised is that the limit is kept, whichever it is; `limits` has those that are in force.
PATIENT = {
    "dynamixel.yaml": {"  timeout: 0.008": "  timeout: 0.05", "  watchdog: 0.1": "  watchdog: 1.0"},
    "supervisor.yaml": {
        "command_hold: 0.1": "command_hold: 0.5", "command_lost: 0.5": "command_lost: 2.0",
        "clock_jump: 0.5": "clock_jump: 60.0", "heartbeat: 0.5": "heartbeat: 3.0",
        "servo_silent: 0.5": "servo_silent: 2.0", "torque_change: 1.0": "torque_change: 2.0",
        "coast_cycles: 3 ": "coast_cycles: 30 ", "sample_gap: 0.05": "sample_gap: 0.5",
        "slack_max: 1.4e-3": "slack_max: 4.0e-3",
    },
    "mpc.yaml": {"time_budget: 0.02": "time_budget: 0.2"},
}  # fmt: skip


class Rig:
    """A graph, and somebody who listens, asks and harms. Times are ns of the messages' clock."""

    def __init__(
        self, directory, config=PATIENT, parameters=None, remaps=None, only=None, **arguments
    ):
        """`parameters` and `remaps` by node; `config`: changes as of `changed_config`;
        `only` these nodes begin at once; `arguments` of the graph."""
        self.directory = directory
        self.bus = directory / "bus"
        self.config = changed_config(directory, config)
        self._more = {name: dict(values) for name, values in (parameters or {}).items()}
        self._remaps = remaps or {}
        graph = read_graph()
        values = {a.name: a.default for a in graph.arguments} | {"hardware": "fake_bus"} | arguments
        if values["hardware"] == "fake_bus":
            values["port"] = str(self.bus)
        self.specs = {spec.name: spec for spec in graph.nodes(values)}
        self.children = {}
        self._injected = set()  # (kind, leg)
        self.heard = defaultdict(list)
        self.transitions = []  # (since, State, reason)
        self._listen()
        self.start(*(self.specs if only is None else only))

    def _listen(self):
        self.context = Context()
        rclpy.init(args=[], context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("tester", context=self.context)
        for topic, (kind, profile) in TOPICS.items():
            self.node.create_subscription(kind, topic, self.heard[topic].append, profile)
        self.node.create_subscription(RobotState, "/robot_state", self._on_state, qos.STATE)
        self._clients = {}
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self):
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def listen(self, topic, kind, profile):
        """Hear one more topic."""
        self.node.create_subscription(kind, topic, self.heard[topic].append, profile)

    def _on_state(self, message):
        now = (nanoseconds(message.since), State(message.state), message.reason)
        if not self.transitions or self.transitions[-1] != now:
            self.transitions.append(now)

    def start(self, *names, parameters=None, program=()):
        """Start nodes, also again; `parameters` and another `program` for this time alone."""
        environment = os.environ | {"SLOT_CONFIG": str(self.config)}
        for name in names:
            executable, *arguments = command_line(self.specs[name])
            more = {**self._more.get(name, {}), **(parameters or {})}
            options = [w for key, value in more.items() for w in ("-p", f"{key}:={value}")]
            remaps = [w for a, b in self._remaps.get(name, {}).items() for w in ("-r", f"{a}:={b}")]
            with self._log(name).open("ab") as log:
                self.children[name] = subprocess.Popen(
                    [*(program or [executable]), *arguments, *options, *remaps],
                    env=environment, stdout=log, stderr=log, start_new_session=True,
                    cwd=self.directory, preexec_fn=die_with_parent,  # noqa: PLW1509 - one system call
                )  # fmt: skip

    def kill(self, name):
        """SIGKILL, and nothing left of the node; returns the time before it."""
        begin = self.send(name, signal.SIGKILL)
        self.exit_code(name)
        return begin

    def _log(self, name):
        return self.directory / f"{name}.log"

    def log(self, name):
        """What a node has written so far."""
        log = self._log(name)
        return log.read_text(errors="replace") if log.exists() else ""

    def log_lines(self, name):
        """The same by lines."""
        return self.log(name).splitlines()

    def send(self, name, number):
        """A signal to a node; returns the time before it."""
        now = self.now()
        self.children[name].send_signal(number)
        return now

    def exit_code(self, name, limit=PATIENCE):
        """Of a node that ends by itself."""
        return self.children[name].wait(limit)

    def now(self):
        """Time of the messages' stamps."""
        return time.time_ns()

    def wait_for(self, condition, limit=PATIENCE, what="waited in vain"):
        """Wait until a condition holds, at most `limit` s; returns what it gave."""
        end = time.monotonic() + limit
        while not (got := condition()):
            assert time.monotonic() < end, f"{what}: {self.story()}"
            time.sleep(0.01)
        return got

    def story(self):
        """What happened, for somebody who wonders why."""
        logs = {name: self.log(name)[-2000:] for name in self.children}
        return "\n".join(
            [*map(str, self.transitions[-12:]), *(f"{n}:\n{t}" for n, t in logs.items())]
        )

    def call(self, kind, service, /, **request):
        """The answer of a service."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
        client = self._clients[service]
        self.wait_for(client.service_is_ready, what=f"no service {service}")
        answer = client.call_async(kind.Request(**request))
        self.wait_for(answer.done, what=f"no answer of {service}")
        return answer.result()

    def ask(self, request):
        """Why the supervisor refuses a request, or ""."""
        return self.call(Trigger, f"/supervisor/{request}").message

    def inject(self, kind, leg="all", clear=False, **values):
        """Let the simulated robot have a fault; returns the time before it."""
        now = self.now()
        answer = self.call(
            InjectFault, "/sim_robot/inject", kind=kind, leg=leg, clear=clear, **values
        )
        assert answer.success, answer.message
        self._injected = {*self._injected, (kind, leg)} - ({(kind, leg)} if clear else set())
        return now

    def heal(self):
        """Take back what a test has left: faults, and nodes that are stopped."""
        for kind, leg in self._injected:
            self.call(InjectFault, "/sim_robot/inject", kind=kind, leg=leg, clear=True)
        self._injected = set()
        for child in self.children.values():
            if child.poll() is None:
                child.send_signal(signal.SIGCONT)

    @property
    def state(self):
        """The supervisor's, as heard last."""
        return self.transitions[-1][1] if self.transitions else None

    def last(self, topic):
        """The newest message of a topic."""
        return self.heard[topic][-1]

    def since(self, topic, time):
        """Messages of a topic stamped at or after a time."""
        return [message for message in list(self.heard[topic]) if decode.stamp(message) >= time]

    def supervisor(self):
        """The settings of supervisor.yaml that are in force."""
        values = yaml.safe_load((self.config / "supervisor.yaml").read_text())
        return build(SupervisorSettings, values, "supervisor.yaml")

    def limit(self, name):
        """A limit of `timing` in supervisor.yaml that is in force, s."""
        return getattr(self.supervisor().timing, name)

    def reached(self, state, time, limit=PATIENCE):
        """(since, reason) of the first transition to a state after a time; waits for it."""

        def found():
            later = (t for t in list(self.transitions) if t[0] >= time and t[1] is state)
            return next(((since, reason) for since, _, reason in later), None)

        return self.wait_for(found, limit, f"never {state.name}")

    def slack(self, time):
        """The first report after a time that torque is off at every servo; waits for it."""
        found = self.wait_for(
            lambda: [m for m in self.since("/servo_health", time) if not any(m.torque)],
            what="torque stays on",
        )
        return found[0]

    def rest(self):
        """Wait until the servos have not moved for half a second; returns their angles, rad."""
        begin = self.now()

        def still():
            angles = [m.position for m in self.since("/joint_states", begin)[-50:]]
            return len(angles) == 50 and np.ptp(angles, axis=0).max() < 1.5 * RAD_PER_COUNT

        self.wait_for(still, what="never at rest")
        return np.array(self.last("/joint_states").position)

    def moved(self, before, time):
        """Least and largest way of any servo from where it was, since a time, counts."""
        angles = [message.position for message in self.since("/joint_states", time)]
        ways = (np.array(angles) - before) / RAD_PER_COUNT
        return ways.min(), ways.max()

    def registers(self, name):
        """A register of every servo, while no driver is there."""
        settings = read_settings()
        port = SerialPort(str(self.bus), settings.bus.baud, 0.5)
        port.open()
        try:
            bus = Bus(port, settings.bus)
            return [bus.read(identity, name)[name] for identity in settings.joints.ids]
        finally:
            port.close()

    def walk(self, limit=PATIENCE):
        """Bring the robot to WALKING, from wherever it is, as an operator would."""
        end = time.monotonic() + limit
        refusal = ""
        while self.state is not State.WALKING:
            assert time.monotonic() < end, f"{refusal}: {self.story()}"
            if self.state in NEXT:
                refusal = self.ask(NEXT[self.state])
            time.sleep(0.05)

    def stop(self, name):
        """Interrupt a node, unless it has ended, and wait for its end."""
        if self.children[name].poll() is None:
            self.send(name, signal.SIGINT)
        return self.exit_code(name)

    def walk_on(self):
        """Bring the robot to WALKING for half a second at least: it is under way."""
        while self.state is not State.WALKING or self.now() - self.transitions[-1][0] < 5e8:
            self.walk()
            time.sleep(0.05)

    def close(self):
        """End every node; returns the exit codes."""
        for child in self.children.values():
            if child.poll() is None:
                child.send_signal(signal.SIGCONT)
                child.send_signal(signal.SIGINT)
        for child in self.children.values():
            try:
                child.wait(10)
            except subprocess.TimeoutExpired:
                os.killpg(child.pid, signal.SIGKILL)
                child.wait()
        self.context.try_shutdown()
        self._thread.join(5)
        return {name: child.returncode for name, child in self.children.items()}


def nanoseconds(stamp):
    """Of a builtin_interfaces/Time."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec
