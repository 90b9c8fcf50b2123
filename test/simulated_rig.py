"""The graph under test in one process on simulated time, without DDS: nodes, topics and services.

The nodes are those of the graph, with their parameters and timers. A message arrives LATENCY after
it was published, and a callback takes no time. So what the robot does in seconds takes only its
computation, and the result depends neither on the machine nor on what else runs there.
"""

import dataclasses
import heapq
import importlib
import itertools
import types
from collections import defaultdict

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rig import TOPICS, Rig
from simulated_ros import (
    Answer,
    Clock,
    Logger,
    Port,
    Publisher,
    StubTerminal,
    Subscription,
    Timer,
)

from slot_bringup.processes import command_line
from slot_core.clock import SECOND
from slot_core.dynamixel.brand import DYNAMIXEL
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.emulator import emulated_legs
from slot_core.servos import registry
from slot_core.simulation import simulated_servos
from slot_msgs.srv import InjectFault
from slot_nodes import (
    dynamixel_driver_node,
    mpc_controller_node,
    runtime,
    sim_robot_node,
)

START = 1_700_000_000 * SECOND  # ns
STEP = 0.01  # s, between two checks of a condition
SOLVE_TIME = 5e-4  # s, of a cycle of the MPC


class SimulatedRig(Rig):
    """A graph with its messages, requests and faults; `kill`, `pause` and `start` act on nodes."""

    def __init__(self, directory, config=None, parameters=None, only=None, **arguments):
        """As Rig, with the time limits of config/, which hold here as on a robot."""
        self._describe(directory, config or {}, parameters, arguments)
        self._time, self._events, self._count = START, [], itertools.count()
        self._building = (
            None  # (name, number of its start) of the node that is being made
        )
        self._starts = itertools.count()
        self._nodes, self._contexts, self.exit_codes = {}, {}, {}
        self._busy, self._paused = [], set()
        self._subscriptions = defaultdict(list)  # by topic
        self.waiting = defaultdict(
            list
        )  # subscriptions with messages for a node that is not free
        self._publishers = []  # (node, publisher)
        self._services = {}  # (node, kind, callback), by name
        self._logs = defaultdict(list)
        self.hidden = set()  # services that are not discovered yet
        self.solve_time = SOLVE_TIME
        self._patch = pytest.MonkeyPatch()
        self._patch.setenv("SLOT_CONFIG", str(self.config))
        self._replace()
        for topic, (_, profile) in TOPICS.items():
            self.subscribe(topic, None, profile)
        self._subscribe(None, "/robot_state", self._on_state, TOPICS["/robot_state"][1])
        self.start(*(self.specs if only is None else only))

    def _replace(self):
        """Replace DDS, clocks and devices of the nodes."""
        rig, patch = self, self._patch.setattr

        def create_publisher(node, kind, topic, profile, **__):
            return rig._publish(rig._building, kind, topic, rig._profile(profile))

        def get_publishers_info_by_topic(node, topic):
            return rig.publishers_of(topic)

        def create_subscription(
            node, _, topic, callback, profile, callback_group=None, **__
        ):
            profile = rig._profile(profile)
            by = rig._building or rig._busy[-1]
            return rig._subscribe(by, topic, callback, profile, callback_group)

        def create_service(node, kind, name, callback, **_):
            full = (
                f"/{rig._building[0]}/{name[2:]}"
                if name[:2] == "~/"
                else f"/{name.lstrip('/')}"
            )
            rig._services[full] = rig._building, kind, callback

        def create_client(node, kind, name):
            service = f"/{name.lstrip('/')}"
            return types.SimpleNamespace(
                service_is_ready=lambda: rig._offers(service),
                call_async=lambda request: Answer(rig, service, request),
            )

        def create_timer(node, period, callback, **_):
            return Timer(rig, rig._building or rig._busy[-1], period, callback)

        for replaced in (
            create_publisher,
            create_subscription,
            create_service,
            create_client,
            create_timer,
            get_publishers_info_by_topic,
        ):
            patch(Node, replaced.__name__, replaced)
        patch(Node, "count_publishers", lambda _, topic: len(rig.publishers_of(topic)))
        patch(Node, "destroy_timer", lambda _, timer: timer.cancel())
        patch(Node, "get_clock", lambda _: Clock(rig))
        patch(Node, "get_logger", lambda node: Logger(rig._logs[node.get_name()]))
        patch(runtime, "get_logger", lambda name: Logger(rig._logs[name.split(".")[0]]))
        ticks = itertools.count()
        clock = types.SimpleNamespace(
            monotonic=rig.seconds,
            monotonic_ns=rig.now,
            sleep=rig.sleep,
            perf_counter=lambda: next(ticks) * rig.solve_time,
        )
        for module in (
            dynamixel_driver_node,
            mpc_controller_node,
            sim_robot_node,
            simulated_servos,
        ):
            patch(module, "time", clock)
        patch(emulated_legs, "PseudoTerminal", StubTerminal)
        brand = dataclasses.replace(DYNAMIXEL, make_bus=rig._make_bus)
        self._patch.setitem(registry.BRANDS, "dynamixel", lambda: brand)

    def _make_bus(self, settings):
        port = Port(self, settings.bus.port, settings.bus.baud, self.seconds)
        return Driver(port, settings, self.seconds)

    @staticmethod
    def _profile(profile):
        """Quality of service, also of a depth alone."""
        plain = types.SimpleNamespace(depth=profile, durability=None)
        return profile if hasattr(profile, "depth") else plain

    # time

    def now(self):
        return self._time

    def seconds(self):
        return self._time / SECOND

    def call_at(self, time, action):
        """Call a function at a time, ns."""
        heapq.heappush(self._events, (time, next(self._count), action))

    def run(self, seconds):
        """Advance the time."""
        self._run_until(self._time + round(seconds * SECOND))

    def _run_until(self, end):
        while self._events and self._events[0][0] <= end:
            self._time, _, action = heapq.heappop(self._events)
            action()
        self._time = end

    def sleep(self, seconds):
        """A node sleeps within a callback: the others go on."""
        self._run_until(self._time + round(seconds * SECOND))

    def wait_for(self, condition, limit=60.0, what="condition not met"):
        """Advance the time until a condition is true, at most `limit` s; returns its value."""
        end = self._time + limit * SECOND
        while not (value := condition()):
            assert self._time < end, f"{what}: {self.recent_events()}"
            self.run(STEP)
        return value

    def every(self, period, action):
        return Timer(self, None, period, action)

    # nodes

    def start(self, *names, parameters=None):
        """Start nodes, also again; `parameters` for this start only."""
        for name in names:
            values = {**self._parameters.get(name, {}), **(parameters or {})}
            options = [
                w for key, value in values.items() for w in ("-p", f"{key}:={value}")
            ]
            context = Context()
            rclpy.init(
                args=[*command_line(self.specs[name]), *options],
                context=context,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            module = importlib.import_module(f"slot_nodes.{name}_node")
            kind = next(
                value
                for key, value in vars(module).items()
                if key.lower() == f"{name}node".replace("_", "")
            )
            self._building = name, next(self._starts)
            self.exit_codes.pop(name, None)
            try:
                with pytest.MonkeyPatch.context() as patch:
                    patch.setattr(
                        "rclpy.node.get_default_context", lambda made=context: made
                    )
                    self._nodes[name] = self._building, kind()
                    self._contexts[name] = context
            finally:
                self._building = None

    def runs(self, name):
        """Whether a node runs."""
        return name in self._nodes

    def is_alive(self, node):
        return node is None or (
            node[0] in self._nodes and self._nodes[node[0]][0] == node
        )

    def is_free(self, node):
        """Whether a node can take a message or a timer."""
        return node is None or (
            self.is_alive(node)
            and node not in self._busy
            and node[0] not in self._paused
        )

    def execute(self, node, callback):
        """Run a callback of a node; a SystemExit ends the node."""
        if node is None:
            callback()
            return
        self._busy.append(node)
        try:
            callback()
        except SystemExit as end:
            self._end(node[0], int(end.code or 0))
        finally:
            self._busy.remove(node)
        self._resume(node)

    def _resume(self, node):
        """Take the messages that came while a node was busy or paused."""
        for subscription in self.waiting.pop(node, ()):
            self.call_at(self._time, subscription.take)

    def _end(self, name, code):
        self._nodes[name][1].destroy_node()
        self._remove(name)
        self.exit_codes[name] = code

    def _remove(self, name):
        _, node = self._nodes.pop(name)
        # only then its DDS participant ends: more than 32 in a domain do not all find each other
        Node.destroy_node(node)
        self._contexts.pop(name).try_shutdown()
        self._paused.discard(name)
        if name == "sim_robot":
            self.bus.unlink(missing_ok=True)
        for subscriptions in self._subscriptions.values():
            subscriptions[:] = [s for s in subscriptions if self.is_alive(s.node)]
        self._publishers = [(n, p) for n, p in self._publishers if self.is_alive(n)]

    def kill(self, name):
        """End a node at once, as SIGKILL does; returns the time."""
        self._remove(name)
        return self._time

    def stop(self, name):
        """End a node as SIGINT does; returns its exit code."""
        node = self._nodes[name][0]
        self.execute(node, lambda: (_ for _ in ()).throw(SystemExit(0)))
        return self.exit_codes[name]

    def pause(self, name):
        """Suspend a node, as SIGSTOP does; returns the time."""
        self._paused.add(name)
        return self._time

    def resume(self, name):
        """Continue a suspended node."""
        self._paused.discard(name)
        self._resume(self._nodes[name][0])

    def exit_code(self, name, limit=60.0):
        """Exit code of a node; waits until it ends by itself."""
        self.wait_for(lambda: name in self.exit_codes, limit)
        return self.exit_codes[name]

    def is_frozen(self):
        """Whether the robot waits for its first command."""
        return self._nodes["sim_robot"][1]._frozen

    def emulated_bus(self):
        """The bus of the emulated servos; None without a robot."""
        if "sim_robot" not in self._nodes:
            return None
        return self._nodes["sim_robot"][1]._plant.emulated.bus

    def registers(self, name):
        """A register of every servo."""
        return [servo.memory[name] for servo in self.emulated_bus().servos]

    # messages and services

    def _publish(self, node, kind, topic, profile):
        made = Publisher(self, kind, topic, profile)
        made.node_name = node[0] if node else "tester"
        self._publishers.append((node, made))
        return made

    def publisher(self, kind, topic, profile):
        return self._publish(None, kind, topic, profile)

    def publishers_of(self, topic):
        """Publishers of a topic, of nodes and of the test."""
        name = f"/{topic.lstrip('/')}"
        return [p for _, p in self._publishers if p.topic_name == name]

    def destroy_publisher(self, publisher):
        self._publishers = [(n, p) for n, p in self._publishers if p is not publisher]

    def _subscribe(self, node, topic, callback, profile, group=None):
        made = Subscription(self, node, callback, profile, group)
        topic = f"/{topic.lstrip('/')}"
        self._subscriptions[topic].append(made)
        if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            for _, publisher in self._publishers:
                if publisher.topic_name == topic and publisher.latches:
                    for message, number in publisher.latched:
                        made.receive(message, number)
        return made

    def subscribe(self, topic, kind, profile):
        """Record one more topic."""
        self._subscribe(None, topic, self.messages[topic].append, profile)

    def deliver(self, topic, message, number):
        for subscription in self._subscriptions[topic]:
            subscription.receive(message, number)

    def _offers(self, service):
        if service in self.hidden:
            return False
        return service in self._services and self.is_alive(self._services[service][0])

    def _serve(self, service, request):
        node, kind, callback = self._services[service]
        response = kind.Response()
        self.execute(node, lambda: callback(request, response))
        return response

    def call(self, kind, service, /, **request):
        """Call a service; returns its answer."""
        self.wait_for(lambda: self._offers(service), what=f"no service {service}")
        return self._serve(service, kind.Request(**request))

    # as of the real rig

    def log_lines(self, name):
        return list(self._logs[name])

    def log(self, name):
        return "\n".join(self._logs[name])

    def recent_events(self):
        lines = (f"{name}:\n" + "\n".join(log[-8:]) for name, log in self._logs.items())
        return "\n".join([*map(str, self.transitions[-12:]), *lines])

    def restore(self):
        for kind, leg in self._injected:
            self.call(InjectFault, "/sim_robot/inject", kind=kind, leg=leg, clear=True)
        self._injected = set()
        for name in list(self._paused):
            self.resume(name)

    def walk(self, limit=60.0):
        """Bring the robot to WALKING from any state, by the requests of an operator."""
        self._request_until_walking(limit, lambda: self.run(0.05))

    def walk_steadily(self):
        """Bring the robot to WALKING, and wait until it has walked for half a second."""
        self.walk()
        self.run(0.5)

    def close(self):
        """Remove every node, and the replacements."""
        for name in list(self._nodes):
            self._remove(name)
        self._patch.undo()
