"""Several nodes of the graph in one process: `controller NAME... --ros-args ...`.

The nodes are those of the separate processes. A message between them is handed over as the object
it is (intra_process.py) and goes out on its topic too. The driver has a thread of its own, so that
neither bus cycles nor computations delay each other. In lockstep, in which one node works at a time
anyway, robot and supervisor share the process too.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from importlib import import_module

import rclpy
import rclpy.utilities
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from slot_core.config import ConfigError
from slot_nodes import runtime
from slot_nodes.process.executor import DirectExecutor
from slot_nodes.process.intra_process import Mailbox, Topics

# In the order of the data: a node that calls `inputs.take_waiting` is made after the publisher.
CONTROLLER = ("state_estimator", "gait_scheduler", "mpc_controller", "force_mapper")
CHAIN = ("sim_robot", *CONTROLLER, "supervisor")
DRIVER = "dynamixel_driver"
SWITCH_INTERVAL = 5e-4  # s after which a thread that computes lets another one on
STOP_PERIOD = 0.1  # s


class ComposedNodes:
    """Nodes of one process: the driver on an executor of its own, all others on one."""

    def __init__(self, names: Sequence[str]) -> None:
        """Make the nodes named; raises ConfigError as they do, and for an unknown name."""
        if unknown := set(names) - {*CHAIN, DRIVER}:
            known = ", ".join([*CHAIN, DRIVER])
            raise ConfigError(f"{sorted(unknown)[0]}: not a node of this process (known: {known})")
        self._topics = Topics()
        self.nodes: list[Node] = []
        self._failure: BaseException | None = None
        self._ended = threading.Event()
        try:
            self._executor = self._make([name for name in CHAIN if name in names])
            self._driver = self._make([DRIVER]) if DRIVER in names else None
        except BaseException:
            self.destroy_node()
            raise

    def _make(self, names: Sequence[str]) -> DirectExecutor:
        """Executor with the nodes named."""
        mailbox = Mailbox()
        executor = DirectExecutor(mailbox)
        with self._topics.nodes_of(mailbox):
            for name in names:
                made = "".join(part.capitalize() for part in name.split("_")) + "Node"
                node = getattr(import_module(f"slot_nodes.{name}_node"), made)()
                self.nodes.append(node)
                executor.add_node(node)
        return executor

    def spin(self) -> None:
        """Serve the nodes until the context ends; raises what ended the driver."""
        thread = threading.Thread(target=self._spin_driver, name=DRIVER)
        if self._driver is not None:
            sys.setswitchinterval(SWITCH_INTERVAL)
            thread.start()
        try:
            while rclpy.utilities.ok() and self._failure is None:
                self._executor.spin_once()
        finally:
            self._ended.set()
            if self._driver is not None:
                thread.join()
            if self._failure is not None:
                raise self._failure

    def _spin_driver(self) -> None:
        assert self._driver is not None
        try:
            while not self._ended.is_set():
                self._driver.spin_once(STOP_PERIOD)
        except ExternalShutdownException:
            pass
        except BaseException as error:
            self._failure = error
            self._executor.wake()

    def destroy_node(self) -> None:
        """End the nodes, the driver first: it switches torque off."""
        for node in reversed(self.nodes):
            node.destroy_node()


def main() -> None:
    """Entry point of the process."""
    names = rclpy.utilities.remove_ros_args(sys.argv)[1:]
    runtime.run(lambda: ComposedNodes(names), ComposedNodes.spin)
