"""Processes of the graph: with one node, or several: `controller NAME... --ros-args ...`.

Several nodes are those of the separate processes. A message between them is handed over as the object
it is (intra_process.py) and goes out on its topic too. In lockstep, in which one node works at a
time anyway, robot and supervisor share the process too.
"""

import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import rclpy.utilities
from rclpy.node import Node

from slot_core.config import ConfigError
from slot_core.messages.carried import Carried
from slot_nodes import qos, runtime
from slot_nodes.process import intra_process
from slot_nodes.process.executor import DirectExecutor
from slot_nodes.process.intra_process import Mailbox

# In the order of the data: a node that calls `inputs.process_received` is made after the publisher.
CONTROLLER = (
    "state_estimator",
    "gait_scheduler",
    "mpc_controller",
    "force_mapper",
)
# The recorder gets the first message too.
CHAIN = ("recorder", "sim_robot", *CONTROLLER, "supervisor")


def node_class(name: str) -> Callable[[], Node]:
    """Class of a node of the graph by the node's name."""
    words = "".join(part.capitalize() for part in name.split("_"))
    return getattr(import_module(f"slot_nodes.{name}_node"), f"{words}Node")


class ComposedNodes:
    """Nodes of one process, on one executor."""

    def __init__(self, names: Sequence[str]) -> None:
        """Make the nodes named; raises ConfigError as they do, and for an unknown name."""
        if unknown := sorted(set(names) - {*CHAIN}):
            known = ", ".join(CHAIN)
            raise ConfigError(
                f"{unknown[0]}: not a node of this process (known: {known})"
            )
        self.nodes: list[Node] = []
        mailbox = Mailbox()
        self._executor = DirectExecutor(mailbox)
        try:
            with mailbox.in_use():
                for name in (name for name in CHAIN if name in names):
                    node = node_class(name)()
                    self.nodes.append(node)
                    _share_clock(node)
                    self._executor.add_node(node)
        except BaseException:
            runtime.close(self.nodes)
            self.destroy_node()
            raise

    def spin(self) -> None:
        """Serve the nodes until the context ends."""
        while rclpy.utilities.ok():
            self._executor.spin_once()

    def destroy_node(self) -> None:
        """Destroy the nodes."""
        for node in reversed(self.nodes):
            node.destroy_node()


def _share_clock(node: Node) -> None:
    """Let a node with the time of /clock get it without DDS, where a node of its process publishes it."""
    name = node.resolve_topic_name("clock")
    for subscription in list(node.subscriptions):
        if subscription.topic_name == name and not subscription.raw:
            intra_process.subscribe_later(
                name,
                partial(_set_time, subscription.callback),
                qos.CLOCK,
                partial(node.destroy_subscription, subscription),
            )


def _set_time(take: Any, clock: Carried, number: int) -> None:
    """Hand a message of /clock to the time source of a node."""
    take(clock.message)


def serve_one() -> None:
    """Entry point of a node's process; the program has the node's name."""
    kind: Any = node_class(Path(sys.argv[0]).name)
    runtime.run(kind, getattr(kind, "serve", runtime.spin))


def main() -> None:
    """Entry point of a process with several nodes."""
    names = rclpy.utilities.remove_ros_args(sys.argv)[1:]
    runtime.run(lambda: ComposedNodes(names), ComposedNodes.spin)
