"""Tables of the graph's arguments, topics, services and parameters, in `slot_bringup/doc/reference`.

`scripts/docs --tables` writes them again: every node of `graph.yaml` is created, asked what it
declares, and destroyed. A folder on the command line is that of the pages.
"""

import inspect
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import rclpy
import yaml
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from documentation import DOC, ROOT
from documentation.markdown import plain, table
from slot_bringup.arguments import graph_arguments
from slot_nodes.process.composed import node_class

MARK = "<!-- Written by scripts/docs --tables. -->\n\n"  # the generated part of a page follows
GRAPH = ROOT / "slot_bringup" / "slot_bringup" / "graph.yaml"
RECORDER = "recorder"  # subscribes to what record.yaml names
# Parameters with which a node shows all that it has; without an entry, none. sim_robot has the
# topics of a camera only in a scene with one.
VARIANTS = {
    RECORDER: [{"bag": "{directory}/bag"}],
    "sim_robot": [{}, {"scene": "marker_camera"}],
}
# Of every node of ROS 2.
STANDARD_TOPICS = {"/rosout", "/parameter_events"}
STANDARD_SERVICES = {
    "rcl_interfaces",
    "type_description_interfaces",
    "lifecycle_msgs",
}
STANDARD_PARAMETERS = (
    "use_sim_time",
    "start_type_description_service",
    "qos_overrides.",
)


def main(folder: Path) -> None:
    """Write the tables into the pages of a folder, each after its mark."""
    found = GraphTables()
    with tempfile.TemporaryDirectory() as directory:
        for node, given in created_nodes(directory):
            found.add(node, given)
    texts = {
        "arguments": arguments(),
        "topics": found.topics(),
        "parameters": found.parameters(),
    }
    for name, text in texts.items():
        page = folder / f"{name}.md"
        page.write_text(page.read_text().partition(MARK)[0] + MARK + text)


def created_nodes(directory: str) -> Iterator[tuple[Node, Mapping[str, str]]]:
    """Yield each node of slot_nodes with the parameters given to it; the next one ends it."""
    for name, entry in yaml.safe_load(GRAPH.read_text())["nodes"].items():
        for variant in (
            VARIANTS.get(name, [{}]) if entry["package"] == "slot_nodes" else ()
        ):
            given = {
                key: value.format(directory=directory)
                for key, value in variant.items()
            }
            options = [
                text
                for item in given.items()
                for text in ("-p", "{}:={}".format(*item))
            ]
            rclpy.init(args=["--ros-args", "--log-level", "error", *options])
            node = node_class(name)()
            yield node, given
            node.destroy_node()
            rclpy.shutdown()


class GraphTables:
    """Rows of the tables, gathered from one node after the other."""

    def __init__(self) -> None:
        self._topics: dict[str, list[Any]] = {}  # type, publishers, subscribers
        self._services: dict[str, tuple[str, str]] = {}  # type, node
        self._docs: dict[str, str] = {}  # by node
        self._parameters: dict[str, dict[str, tuple[str, ...]]] = {}  # by node

    def add(self, node: Any, given: Mapping[str, str]) -> None:
        """Add the declarations of a node that was created with the parameters `given`."""
        name = node.get_name()
        self._docs[name] = (inspect.getdoc(type(node)) or "").partition("\n")[0]
        for end in node.publishers:
            self._add_end(end, 1, name)
        for end in node.subscriptions if name != RECORDER else ():
            self._add_end(end, 2, name)
        for service in node.services:
            if _package(service.srv_type) not in STANDARD_SERVICES:
                full = node.resolve_service_name(service.srv_name)
                self._services[full] = _kind(service.srv_type), name
        rows = self._parameters.setdefault(name, {})
        for parameter, declared in sorted(
            node.get_parameters_by_prefix("").items()
        ):
            if not parameter.startswith(STANDARD_PARAMETERS):
                described = node.describe_parameter(parameter)
                value = "" if parameter in given else code(declared.value)
                row = value, _range(described), plain(described.description)
                rows.setdefault(parameter, row)  # of the first variant

    def _add_end(self, end: Any, column: int, node: str) -> None:
        if end.topic_name not in STANDARD_TOPICS:
            kind = _kind(end.msg_type) + _quality(end.qos_profile)
            row = self._topics.setdefault(end.topic_name, [kind, {}, {}])
            # a publisher's quality of service prevails
            row[0] = kind if column == 1 else row[0]
            row[column][node] = None

    def topics(self) -> str:
        """Tables of the topics, without the recorder's subscriptions, and of the services."""
        topics = [
            (f"`{topic}`", kind, ", ".join(publishers), ", ".join(subscribers))
            for topic, (kind, publishers, subscribers) in sorted(
                self._topics.items()
            )
        ]
        services = [
            (f"`{name}`", *row) for name, row in sorted(self._services.items())
        ]
        return (
            "## Topics\n\n"
            + table(("topic", "type", "published by", "subscribed by"), topics)
            + "\n## Services\n\n"
            + table(("service", "type", "served by"), services)
        )

    def parameters(self) -> str:
        """A table of the parameters of each node."""
        header = "parameter", "default", "range", "meaning"
        return "\n".join(
            f"## {node}\n\n{plain(self._docs[node])}\n\n"
            + table(header, [(f"`{name}`", *row) for name, row in rows.items()])
            for node, rows in self._parameters.items()
        )


def arguments() -> str:
    """Table of the graph's arguments: options of scripts/run, and of the launch file."""
    rows = []
    for argument in graph_arguments():
        choices = (
            f"; one of {', '.join(argument.choices)}"
            if argument.choices
            else ""
        )
        rows.append(
            (
                f"`--{argument.name.replace('_', '-')}`",
                f"`{argument.name}`",
                argument.kind.__name__,
                code(argument.default),
                plain(argument.help + choices),
            )
        )
    return table(
        (
            "option of scripts/run",
            "launch argument",
            "type",
            "default",
            "meaning",
        ),
        rows,
    )


def _package(kind: type) -> str:
    return kind.__module__.partition(".")[0]


def _kind(kind: type) -> str:
    """Name of a message or service; those of this repository with a link to their definition."""
    package, name = _package(kind), kind.__name__
    text = f"`{package}/{name}`"
    return (
        f"[{text}](messages.md#{name.lower()})"
        if package == "slot_msgs"
        else text
    )


def _quality(profile: QoSProfile) -> str:
    """Deviations of a topic's quality of service from a reliable, volatile one."""
    latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    lossy = profile.reliability == ReliabilityPolicy.BEST_EFFORT
    return ", latched" * latched + ", best effort" * lossy


def _range(descriptor: ParameterDescriptor) -> str:
    for bound in (*descriptor.integer_range, *descriptor.floating_point_range):
        return f"{bound.from_value:g} to {bound.to_value:g}"
    return plain(descriptor.additional_constraints)


def code(value: Any) -> str:
    """A value as in YAML, in the fixed-width font; empty for None and an empty text."""
    text = value if isinstance(value, str) else json.dumps(value)
    return "" if value in (None, "") else f"`{text}`"


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else DOC / "reference")
