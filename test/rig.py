"""The graph under test in one process on simulated time: its nodes, on rclpy, with a stepped clock.

One executor serves them while the time stands still. Then the time advances: by LATENCY if
something was served, else by IDLE_STEP. So what the robot does in seconds takes only its computation,
and no limit depends on the load of the machine.
"""

import dataclasses
import functools
import itertools
import traceback
import types
from collections import defaultdict

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.clock import ROSClock
from rclpy.context import Context
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from real_graph import changed_config, nodes_of
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from slot_bringup.processes import command_line
from slot_core.clock import SECOND
from slot_core.dynamixel.brand import DYNAMIXEL
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.emulator.emulated_legs import MemoryPort
from slot_core.messages import decode
from slot_core.safety.states import State
from slot_core.servos import registry
from slot_core.simulation import simulated_servos
from slot_msgs.msg import RobotState, ServoHealth
from slot_msgs.srv import InjectFault
from slot_nodes import (
    dynamixel_driver_node,
    mpc_controller_node,
    qos,
    runtime,
    sim_robot_node,
)
from slot_nodes.process.composed import node_class
from slot_nodes.process.executor import KINDS, DirectExecutor

START = 1_700_000_000 * SECOND  # ns
LATENCY = 200_000  # ns, of a message
IDLE_STEP = 2_000_000  # ns
WAIT_LIMIT = 60.0  # s, of any wait
SOLVE_TIME = 5e-4  # s, of a cycle of the MPC
SLEEPERS = {  # modules that use a clock of the machine, with their nodes
    dynamixel_driver_node: "dynamixel_driver",
    mpc_controller_node: "mpc_controller",
    sim_robot_node: "sim_robot",
    simulated_servos: "sim_robot",
}
TOPICS = {
    "/robot_state": (RobotState, qos.STATE),
    "/servo_health": (ServoHealth, qos.SENSOR),
    "/diagnostics": (DiagnosticArray, qos.SENSOR),
    "/joint_states": (JointState, qos.SENSOR),
    "/desired_joint_angles": (JointState, qos.CONTROL),
    "/odom": (Odometry, qos.SENSOR),
}
# Request that leads towards WALKING, by state.
NEXT_REQUEST = {
    State.ESTOP: "reset",
    State.FAULT: "reset",
    State.IDLE: "ready",
    State.READY: "stand",
    State.STANDING: "walk",
}


class NotingExecutor(DirectExecutor):
    """Executor that notes whether something was ready, and leaves events of topics out."""

    def _collect_entities(self):
        super()._collect_entities()
        self._waitables = []

    def _wait(self, timeout_sec):
        super()._wait(timeout_sec)
        ready = self._wait_set.get_ready_entities
        self.served = any(
            ready(kind) for kind in KINDS if kind != "guard_condition"
        )


class Rig:
    """A graph with its messages, requests and faults. Times are ns of the messages' clock."""

    def __init__(self, directory, config=None, only=None, **arguments):
        """`config`: as for `changed_config`; `only`: nodes to start now, else all;
        `arguments`: of the graph."""
        self.config = changed_config(directory, config or {})
        self._port = str(directory / "bus")
        given = {"hardware": "sim", "port": self._port} | arguments
        self.specs = nodes_of(**given)
        self.nodes, self.exit_codes = {}, {}  # by name
        self.logs = defaultdict(list)
        self.messages = defaultdict(list)
        self.transitions = []  # (since, State, reason)
        self.solve_time = SOLVE_TIME
        self._clients, self._arguments = {}, []
        self._clock = ROSClock()
        self._clock._set_ros_time_is_active(True)
        self._set_time(START)
        self._patch = pytest.MonkeyPatch()
        self._open_node()
        self.start(*(self.specs if only is None else only))

    def _open_node(self):
        """Make the node of the test, and subscribe to TOPICS."""
        self.context = Context()
        no_handlers = SignalHandlerOptions.NO
        rclpy.init(
            args=[], context=self.context, signal_handler_options=no_handlers
        )
        self._replace()
        self.node = rclpy.create_node("tester", context=self.context)
        self._executor = NotingExecutor(context=self.context)
        self._executor.add_node(self.node)
        for topic, (kind, profile) in TOPICS.items():
            self.subscribe(topic, kind, profile)
        self.node.create_subscription(
            RobotState, "/robot_state", self._on_state, qos.STATE
        )

    def _replace(self):
        """Replace the clocks of the nodes, their logs, and the device of the servos."""
        patch, make_node = self._patch.setattr, Node.__init__
        self._patch.setenv("SLOT_CONFIG", str(self.config))

        def make(node, name, **options):
            given = {"context": self.context, "cli_args": self._arguments}
            # nobody asks for parameters, whose services are the half of all that is waited for
            make_node(
                node,
                name,
                **given | options | {"start_parameter_services": False},
            )

        def log(logger, message, severity, **_):
            self.logs[logger.name.split(".")[0]].append(message)

        patch(Node, "__init__", make)
        patch(Node, "get_clock", lambda _: self._clock)
        patch(runtime, "Clock", lambda clock_type: self._clock)
        patch(RcutilsLogger, "log", log)
        ticks = itertools.count()
        clock = {
            "monotonic": self.seconds,
            "monotonic_ns": self.now,
            "perf_counter": lambda: next(ticks) * self.solve_time,
        }
        for module, name in SLEEPERS.items():
            sleep = functools.partial(self._sleep, name)
            patch(module, "time", types.SimpleNamespace(**clock, sleep=sleep))
        brand = dataclasses.replace(DYNAMIXEL, make_bus=self._make_bus)
        self._patch.setitem(registry.BRANDS, "dynamixel", lambda: brand)

    def _make_bus(self, settings):
        """Driver of the emulated servos; at another port, of none."""
        if settings.bus.port != self._port:
            return DYNAMIXEL.make_bus(settings)
        port = MemoryPort(self._bus(), settings.bus.baud, self.seconds)
        port.port_name = settings.bus.port
        return Driver(port, settings, self.seconds)

    def _bus(self):
        return self.nodes["sim_robot"]._plant.emulated.bus

    # time

    def now(self):
        """Present time of the messages' clock."""
        return self._time

    def seconds(self):
        return self._time / SECOND

    def _set_time(self, time):
        self._time = time
        self._clock.set_ros_time_override(
            Time(nanoseconds=time, clock_type=self._clock.clock_type)
        )

    def run(self, seconds):
        """Let the graph run, and receive its messages."""
        end = self._time + round(seconds * SECOND)
        while self._time < end:
            try:
                self._executor.spin_once(0.0)
            except SystemExit as raised:
                *_, (frame, _) = traceback.walk_tb(raised.__traceback__)
                module = frame.f_globals["__name__"].split(".")[-1]
                self.stop(module.removesuffix("_node"), int(raised.code or 0))
            step = LATENCY if self._executor.served else IDLE_STEP
            self._set_time(min(end, self._time + step))

    def _sleep(self, name, seconds):
        """A node sleeps within a callback: the others go on."""
        self.pause(name)
        self.run(seconds)
        self.resume(name)

    def every(self, period, action):
        """Call a function of the test with a period, s; returns a timer with `cancel`."""
        return self.node.create_timer(period, action, clock=self._clock)

    def wait_for(self, condition, limit=WAIT_LIMIT):
        """Wait until a condition is true, at most `limit` s; returns its value."""
        end = self._time + limit * SECOND
        while not (value := condition()):
            assert self._time < end, (self.transitions[-12:], self.logs)
            self.run(0.01)
        return value

    # nodes

    def start(self, *names, parameters=()):
        """Start nodes, also again; `parameters` for this start only."""
        for name in names:
            options = [
                f"{key}:={value}" for key, value in dict(parameters).items()
            ]
            self._arguments = command_line(self.specs[name])[1:]
            for option in options:
                self._arguments += ["-p", option]
            self.exit_codes.pop(name, None)
            self.nodes[name] = node_class(name)()
            self._executor.add_node(self.nodes[name])
        self._arguments = []

    def stop(self, name, code=0):
        """End a node as SIGINT does, or with another exit code."""
        runtime.close([self.nodes[name]])
        self.kill(name)
        self.exit_codes[name] = code

    def kill(self, name):
        """End a node at once, as SIGKILL does; returns the time."""
        self.nodes[name].destroy_node()
        self._executor.remove_node(self.nodes.pop(name))
        return self._time

    def pause(self, name):
        """Suspend a node, as SIGSTOP does; returns the time."""
        self._executor.remove_node(self.nodes[name])
        return self._time

    def resume(self, name):
        """Continue a suspended node."""
        self._executor.add_node(self.nodes[name])

    def log(self, name):
        """Output of a node so far."""
        return "\n".join(self.logs[name])

    def registers(self, name):
        """A register of every emulated servo."""
        return [servo.memory[name] for servo in self._bus().servos]

    def close(self):
        """Remove every node, and the replacements."""
        for name in [*self.nodes]:
            self.kill(name)
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
        self._patch.undo()

    # messages and services

    def subscribe(self, topic, kind, profile):
        """Keep the messages of a topic."""
        self.node.create_subscription(
            kind, topic, self.messages[topic].append, profile
        )

    def publisher(self, kind, topic, profile):
        return self.node.create_publisher(kind, topic, profile)

    def publisher_of(self, topic):
        """Publisher of the node that publishes a topic."""
        found = (p for node in self.nodes.values() for p in node.publishers)
        return next(p for p in found if p.topic_name == topic)

    def last(self, topic):
        return self.messages[topic][-1]

    def since(self, topic, time):
        """Messages of a topic stamped at or after a time."""
        return [m for m in self.messages[topic] if decode.stamp(m) >= time]

    def call(self, kind, service, /, **request):
        """Call a service; returns its answer."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
        client = self._clients[service]
        self.wait_for(client.service_is_ready)
        answer = client.call_async(kind.Request(**request))
        self.wait_for(answer.done)
        return answer.result()

    def request(self, name):
        """Make a request to the supervisor; returns why it is refused, or ""."""
        return self.call(Trigger, f"/supervisor/{name}").message

    def inject(self, kind, leg="all", clear=False, **values):
        """Inject a fault into the simulated robot, or clear it; returns the time before it."""
        begin, values = self._time, values | {"leg": leg, "clear": clear}
        answer = self.call(
            InjectFault, "/sim_robot/inject", kind=kind, **values
        )
        assert answer.success, answer.message
        return begin

    # state of the supervisor

    def _on_state(self, message):
        now = (decode.time(message.since), State(message.state), message.reason)
        if not self.transitions or self.transitions[-1] != now:
            self.transitions.append(now)

    @property
    def state(self):
        """State of the supervisor in its newest message; None without one."""
        return self.transitions[-1][1] if self.transitions else None

    def wait_for_state(self, state, time):
        """Wait for a transition to `state` at or after `time`; returns (since, reason)."""

        def found():
            later = (t for t in self.transitions if t[0] >= time)
            return next((t[::2] for t in later if t[1] is state), None)

        return self.wait_for(found)

    def wait_for_torque_off(self, time):
        """Wait for a health report since `time` with every torque off; returns the first."""

        def found():
            reports = self.since("/servo_health", time)
            return next((m for m in reports if not any(m.torque)), None)

        return self.wait_for(found)

    def walk(self):
        """Let the robot walk for half a second, from any state, by the requests of an operator."""

        def walks():
            if self.state in NEXT_REQUEST:
                self.request(NEXT_REQUEST[self.state])
            return self.state is State.WALKING and (
                self._time - self.transitions[-1][0] >= SECOND // 2
            )

        self.wait_for(walks)
