"""Timers, topics, clocks and ports of the nodes of a SimulatedRig, in place of rclpy's."""

import inspect
import types
from collections import deque
from pathlib import Path

from rclpy.qos import DurabilityPolicy

from slot_core.clock import SECOND
from slot_core.dynamixel.emulator.emulated_legs import MemoryPort
from slot_core.servos.servo_bus import PortError
from slot_nodes.process.executor import PolledGroup

LATENCY = 200_000  # ns, of a message
DEVICE = "/dev/pts/ptmx"  # stands for the device of the emulated bus


class Timer:
    """Timer of a node on simulated time."""

    def __init__(self, rig, node, period, callback):
        self._rig, self._node, self._callback = rig, node, callback
        self._period, self._number = round(period * SECOND), 0
        self.reset()

    def reset(self):
        self._number += 1
        self._schedule(self._number)

    def cancel(self):
        self._number += 1

    def _schedule(self, number):
        self._rig.call_at(self._rig.now() + self._period, lambda: self._fire(number))

    def _fire(self, number):
        if number == self._number and self._rig.is_alive(self._node):
            self._schedule(number)
            if self._rig.is_free(self._node):
                self._rig.execute(self._node, self._callback)


class Subscription:
    """Subscription of a node: messages wait in a queue as long as its profile allows."""

    msg_type, raw = None, False

    def __init__(self, rig, node, callback, profile, group=None):
        self._rig, self.node, self.callback = rig, node, callback
        self._group = group
        self.handle = self
        self._queue = deque(maxlen=profile.depth)
        needed = [
            p
            for p in inspect.signature(callback or print).parameters.values()
            if p.kind is p.POSITIONAL_OR_KEYWORD and p.default is p.empty
        ]
        self._with_info = len(needed) == 2

    def receive(self, message, number):
        self._queue.append((message, {"publication_sequence_number": number}))
        if not isinstance(self._group, PolledGroup) or self._group.awaited:
            self._rig.call_at(self._rig.now() + LATENCY, self.take)

    def take_message(self, kind, raw):
        """The next message with its information, or None."""
        return self._queue.popleft() if self._queue else None

    def take(self):
        """Call the node with the next message if it is free."""
        if not self._rig.is_free(self.node):
            self._rig.waiting[self.node].append(self)
        elif self._queue:
            message, info = self._queue.popleft()
            self._rig.execute(self.node, lambda: self._call(message, info))

    def _call(self, message, info):
        self.callback(message, info) if self._with_info else self.callback(message)


class Publisher:
    """Publisher of a node, or of the test."""

    node_namespace = "/"

    def __init__(self, rig, kind, topic, profile):
        self._rig, self.topic_name = rig, f"/{topic.lstrip('/')}"
        package = kind.__module__.split(".")[0]
        self.topic_type = f"{package}/msg/{kind.__name__}"
        self.latched = deque(maxlen=profile.depth)
        self.latches = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self._number = 0

    def publish(self, message):
        self._number += 1
        if self.latches:
            self.latched.append((message, self._number))
        self._rig.deliver(self.topic_name, message, self._number)

    def get_subscription_count(self):
        return len(self._rig._subscriptions[self.topic_name])


class Answer:
    """Future answer of a service that a node has called."""

    def __init__(self, rig, service, request):
        self._rig, self._served = rig, None

        def serve():
            self._response = rig._serve(service, request)
            self._served = rig.now()

        rig.call_at(rig.now() + LATENCY, serve)

    def done(self):
        """Whether the answer has arrived."""
        return self._served is not None and self._rig.now() >= self._served + LATENCY

    def result(self):
        """The response."""
        return self._response


class Clock:
    """ROS clock of a node."""

    def __init__(self, rig):
        self._rig = rig

    def now(self):
        return types.SimpleNamespace(nanoseconds=self._rig.now())


class Logger:
    """Logger of a node; it does not throttle."""

    def __init__(self, lines):
        self._lines = lines

    def info(self, line, **_):
        self._lines.append(line)

    debug = warning = error = fatal = info


class StubTerminal:
    """Port of the emulated bus in the same process; replaces the pseudo-terminal."""

    in_use = False  # the driver is not run while the robot closes

    def __init__(self, bus, link):
        self._link = link
        link.unlink(missing_ok=True)
        link.symlink_to(DEVICE)

    def release(self):
        """Do nothing: no other process has the port open."""

    def close(self):
        self._link.unlink(missing_ok=True)


class Port(MemoryPort):
    """Port of the driver, which is lost with the robot or its plug."""

    def __init__(self, rig, name, *arguments):
        self._rig = rig
        super().__init__(None, *arguments)
        self.port_name = name

    def open(self):
        self._bus = self._rig.emulated_bus()
        if self._bus is None or not Path(self.port_name).exists():
            raise PortError(f"{self.port_name}: no such port")
        super().open()

    def writePort(self, packet):  # noqa: N802
        if (
            self._bus is None
            or self._bus.unplugged
            or self._bus is not self._rig.emulated_bus()
        ):
            raise PortError("memory: the port has disappeared")
        return super().writePort(packet)
