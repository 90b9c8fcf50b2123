"""Reference of the nodes: their topics, services and parameters, as the nodes declare them.

Every node of `graph.yaml` is created, asked and destroyed.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import inspect
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

import rclpy
import yaml
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from documentation.markdown import ROOT, code, plain, table

GRAPH = ROOT / "slot_bringup" / "slot_bringup" / "graph.yaml"
RECORDER = "recorder"
# Parameters with which a node shows all that it has; without an entry, none. sim_robot has the
# topics of a camera only in a scene with one.
VARIANTS = {
    RECORDER: [{"bag": "{directory}/bag"}],
    "sim_robot": [{}, {"scene": "marker_camera"}],
}
# Of every node of ROS 2.
STANDARD_TOPICS = {"/rosout", "/parameter_events"}
STANDARD_SERVICES = {"rcl_interfaces", "type_description_interfaces", "lifecycle_msgs"}
STANDARD_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


@dataclass(frozen=True)
class End:
    """One end of a topic."""

    topic: str
    kind: type
    profile: QoSProfile


@dataclass(frozen=True)
class Description:
    """What a node declares."""

    name: str
    doc: str
    publishes: tuple[End, ...]
    subscribes: tuple[End, ...]
    services: tuple[tuple[str, type], ...]
    parameters: tuple[tuple[Any, ParameterDescriptor], ...]  # default, descriptor


@functools.cache
def descriptions() -> tuple[Description, ...]:
    """What each node of slot_nodes declares, in the order of graph.yaml; some in two variants."""
    nodes = yaml.safe_load(GRAPH.read_text())["nodes"]
    with tempfile.TemporaryDirectory() as directory:
        return tuple(
            describe(name, {k: v.format(directory=directory) for k, v in variant.items()})
            for name, entry in nodes.items()
            if entry["package"] == "slot_nodes"
            for variant in VARIANTS.get(name, [{}])
        )


def describe(name: str, parameters: Mapping[str, str]) -> Description:
    """What a node declares when it is created with some parameters."""
    (program,) = entry_points(group="console_scripts", name=name)
    module = importlib.import_module(program.module)
    (kind,) = (
        kind for _, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, Node) and kind.__module__ == module.__name__
    )  # fmt: skip
    given = [text for item in parameters.items() for text in ("-p", "{}:={}".format(*item))]
    rclpy.init(args=["--ros-args", "--log-level", "error", *given])
    with contextlib.ExitStack() as stack:
        stack.callback(rclpy.shutdown)
        node = kind()
        stack.callback(node.destroy_node)
        return _description(node, inspect.getdoc(kind) or "", parameters)


def _description(node: Any, doc: str, given: Mapping[str, str]) -> Description:
    declared: dict[str, Any] = dict(node.get_parameters_by_prefix(""))
    own = [name for name in declared if not name.startswith(STANDARD_PARAMETERS)]
    return Description(
        name=node.get_name(),
        doc=doc.partition("\n")[0],
        publishes=_ends(node.publishers),
        subscribes=_ends(node.subscriptions),
        services=tuple(
            (node.resolve_service_name(service.srv_name), service.srv_type)
            for service in node.services
            if _package(service.srv_type) not in STANDARD_SERVICES
        ),
        parameters=tuple(
            (None if name in given else declared[name].value, node.describe_parameter(name))
            for name in sorted(own)
        ),
    )


def _ends(found: Any) -> tuple[End, ...]:
    ends = (End(one.topic_name, one.msg_type, one.qos_profile) for one in found)
    return tuple(end for end in ends if end.topic not in STANDARD_TOPICS)


def _package(kind: type) -> str:
    return kind.__module__.partition(".")[0]


def topics() -> str:
    """Tables of the topics, without the recorder's subscriptions, and of the services."""
    publishes = [(node, end) for node in descriptions() for end in node.publishes]
    subscribes = [
        (node, end) for node in descriptions() for end in node.subscribes if node.name != RECORDER
    ]
    ends = sorted((end for _, end in publishes + subscribes), key=lambda end: end.topic)
    rows = {
        end.topic: (
            f"`{end.topic}`",
            _kind(end.kind) + _quality(end.profile),
            _list(node.name for node, other in publishes if other.topic == end.topic),
            _list(node.name for node, other in subscribes if other.topic == end.topic),
        )
        for end in ends
    }
    services = {
        (f"`{name}`", _kind(kind), plain(node.name))
        for node in descriptions()
        for name, kind in node.services
    }
    return (
        "## Topics\n\n"
        + table(("topic", "type", "published by", "subscribed by"), rows.values())
        + "\n## Services\n\n"
        + table(("service", "type", "served by"), sorted(services))
    )


def _list(nodes: Iterable[str]) -> str:
    """Names without repetition."""
    return ", ".join(plain(name) for name in dict.fromkeys(nodes))


def _kind(kind: type) -> str:
    """Name of a message or service; those of this repository with a link to their definition."""
    package, name = _package(kind), kind.__name__
    if package == "slot_msgs":
        return f"[`{package}/{name}`](messages.md#{name.lower()})"
    return f"`{package}/{name}`"


def _quality(profile: QoSProfile) -> str:
    """What a topic's quality of service has of its own, else nothing."""
    latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    lossy = profile.reliability == ReliabilityPolicy.BEST_EFFORT
    return ", latched" * latched + ", best effort" * lossy


def parameters() -> str:
    """A table of parameters for each node."""
    found: dict[str, dict[str, tuple[str, ...]]] = {}
    docs = {}
    for node in descriptions():
        docs[node.name] = node.doc
        rows = found.setdefault(node.name, {})
        for value, descriptor in node.parameters:
            row = (f"`{descriptor.name}`", code(value), _range(descriptor),
                   plain(descriptor.description))  # fmt: skip
            rows.setdefault(descriptor.name, row)  # the default is that of the first variant
    return "\n".join(
        f"## {name}\n\n{plain(docs[name])}\n\n"
        + table(("parameter", "default", "range", "meaning"), rows.values())
        for name, rows in found.items()
    )


def _range(descriptor: ParameterDescriptor) -> str:
    for bound in (*descriptor.integer_range, *descriptor.floating_point_range):
        return f"{bound.from_value:g} to {bound.to_value:g}"
    return plain(descriptor.additional_constraints)
