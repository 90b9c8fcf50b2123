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
from rclpy.clock import ROSClock
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.time import Time
from rig import Rig

from slot_bringup.processes import command_line
from slot_core.clock import SECOND
from slot_core.dynamixel.brand import DYNAMIXEL
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.emulator.emulated_legs import MemoryPort
from slot_core.servos import registry
from slot_core.simulation import simulated_servos
from slot_nodes import (
    dynamixel_driver_node,
    mpc_controller_node,
    runtime,
    sim_robot_node,
)
from slot_nodes.process.composed import node_class
from slot_nodes.process.executor import KINDS, DirectExecutor

START = 1_700_000_000 * SECOND  # ns
LATENCY = 200_000  # ns, of a message
IDLE_STEP = 2_000_000  # ns
SOLVE_TIME = 5e-4  # s, of a cycle of the MPC
SLEEPERS = {  # modules that use a clock of the machine, with their nodes
    dynamixel_driver_node: "dynamixel_driver",
    mpc_controller_node: "mpc_controller",
    sim_robot_node: "sim_robot",
    simulated_servos: "sim_robot",
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


class SimulatedRig(Rig):
    """A graph with its messages, requests and faults; `kill`, `pause` and `start` act on nodes."""

    def __init__(
        self, directory, config=None, parameters=None, only=None, **arguments
    ):
        """As Rig, with the time limits of config/, which hold here as on a robot."""
        self._time, self._clock = START, ROSClock()
        self._clock._set_ros_time_is_active(True)
        self._set_time(START)
        self._nodes, self.exit_codes = {}, {}  # by name
        self._logs = defaultdict(list)
        self.solve_time = SOLVE_TIME
        self._patch = pytest.MonkeyPatch()
        arguments = {"hardware": "sim"} | arguments
        super().__init__(directory, config or {}, parameters, only, **arguments)

    def _open_node(self):
        self._replace()
        self._arguments = []
        super()._open_node(NotingExecutor)

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
            self._logs[logger.name.split(".")[0]].append(message)

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
        if settings.bus.port != str(self.bus):
            return DYNAMIXEL.make_bus(settings)
        port = MemoryPort(self._bus(), settings.bus.baud, self.seconds)
        port.port_name = settings.bus.port
        return Driver(port, settings, self.seconds)

    def _bus(self):
        return self.node_of("sim_robot")._plant.emulated.bus

    # time

    def now(self):
        return self._time

    def seconds(self):
        return self._time / SECOND

    def _set_time(self, time):
        self._time = time
        self._clock.set_ros_time_override(
            Time(nanoseconds=time, clock_type=self._clock.clock_type)
        )

    def run(self, seconds):
        end = self._time + round(seconds * SECOND)
        while self._time < end:
            try:
                self._executor.spin_once(0.0)
            except SystemExit as raised:
                *_, (frame, _) = traceback.walk_tb(raised.__traceback__)
                module = frame.f_globals["__name__"].split(".")[-1]
                self._end(module.removesuffix("_node"), int(raised.code or 0))
            step = LATENCY if self._executor.served else IDLE_STEP
            self._set_time(min(end, self._time + step))

    def _sleep(self, name, seconds):
        """A node sleeps within a callback: the others go on."""
        self.pause(name)
        self.run(seconds)
        self.resume(name)

    def every(self, period, action):
        return self.node.create_timer(period, action, clock=self._clock)

    # nodes

    def start(self, *names, parameters=None):
        """Start nodes, also again; `parameters` for this start only."""
        for name in names:
            values = {**self._parameters.get(name, {}), **(parameters or {})}
            options = [
                w
                for item in values.items()
                for w in ("-p", "{}:={}".format(*item))
            ]
            self._arguments = [*command_line(self.specs[name])[1:], *options]
            self.exit_codes.pop(name, None)
            self._nodes[name] = node_class(name)()
            self._executor.add_node(self._nodes[name])
        self._arguments = []

    def runs(self, name):
        return name in self._nodes

    def node_of(self, name):
        return self._nodes[name]

    def publisher_of(self, topic):
        found = (p for node in self._nodes.values() for p in node.publishers)
        return next(p for p in found if p.topic_name == topic)

    def _end(self, name, code):
        runtime.close([self._nodes[name]])
        self._nodes[name].destroy_node()
        self._remove(name)
        self.exit_codes[name] = code

    def _remove(self, name):
        self._executor.remove_node(self._nodes.pop(name))

    def kill(self, name):
        """End a node at once, as SIGKILL does; returns the time."""
        self._nodes[name].destroy_node()
        self._remove(name)
        return self._time

    def stop(self, name):
        """End a node as SIGINT does; returns its exit code."""
        self._end(name, 0)
        return 0

    def pause(self, name):
        """Suspend a node, as SIGSTOP does; returns the time."""
        self._executor.remove_node(self._nodes[name])
        return self._time

    def resume(self, name):
        """Continue a suspended node."""
        self._executor.add_node(self._nodes[name])

    def exit_code(self, name):
        self.wait_for(
            lambda: name in self.exit_codes, what=f"{name} does not end"
        )
        return self.exit_codes[name]

    def registers(self, name):
        return [servo.memory[name] for servo in self._bus().servos]

    def log(self, name):
        return "\n".join(self._logs[name])

    def close(self):
        """Remove every node, and the replacements."""
        for name in [*self._nodes]:
            self.kill(name)
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
        self._patch.undo()
