"""Node graph of `graph.yaml`: computes the nodes to start from the values of the arguments."""

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from slot_bringup.arguments import graph_arguments
from slot_core.control.policies import GAIT_ALONE
from slot_core.dynamics.scene import read_scene
from slot_core.estimation.inertial_filter import NO_ODOMETRY

CONTROLLER = "controller"  # executable of the nodes in one process
ALWAYS, LOCKSTEP = "always", "lockstep"  # when a node can share that process
# what the graph does when a process ends
END, GO_ON, RESTART = ("end", "go_on", "restart")
RESTARTS = 3  # of a process
REFUSED = 2  # exit code of a node whose configuration is refused
CORES = 2  # least number for a real-time priority that nobody has asked for

# Before a node's command line: the kernel sends SIGTERM to the node when its parent ends, for
# whatever reason. Not SIGINT, which is lost while Python imports a module that catches it.
TIED = ("setpriv", "--pdeathsig", "TERM")


@dataclass(frozen=True)
class NodeSpec:
    """Node of the graph, or several in one process; named after its executable."""

    name: str
    package: str
    parameters: dict[str, Any]
    namespace: str = ""
    remappings: Mapping[str, str] = field(default_factory=dict)
    nodes: tuple[str, ...] = ()  # of a process with several
    params_file: str = ""  # of parameters; `parameters` prevail
    # in addition to its parent's
    environment: Mapping[str, str] = field(default_factory=dict)
    if_it_ends: str = END

    @property
    def node_name(self) -> str | None:
        """Name of the only node in the process; None if there are several."""
        return None if self.nodes else self.name


class Graph:
    """Arguments of the graph, and its nodes as described by `graph.yaml`."""

    def __init__(self, description: Mapping[str, Any]):
        self.arguments = graph_arguments()
        self._common = description["parameters"]
        self._remappings = description["remappings"]
        self._nodes = description["nodes"]
        self.names = tuple(self._nodes)  # of all nodes

    def nodes(self, values: Mapping[str, Any]) -> list[NodeSpec]:
        """Nodes to start; `values` holds the value of every argument by name.

        `composed` comes from `composition.choose`; None stands for false.
        """
        values = {**values, **_computed(values)}
        values["about"] = self.about(values)
        remappings, first = self.remappings(values), _priority(values)
        specs = [
            NodeSpec(
                name=name,
                package=entry["package"],
                parameters=self._parameters(entry, values),
                namespace=values["namespace"],
                remappings=remappings,
                params_file=values["params_file"],
                environment=first if "realtime" in entry else {},
                if_it_ends=self.if_it_ends(name),
            )
            for name, entry in self._nodes.items()
            if name not in values["without"].split(",")
            and values["hardware"]
            in entry.get("hardware", [values["hardware"]])
            and ("needs" not in entry or values[entry["needs"]])
            and ("unless" not in entry or not values[entry["unless"]])
        ]
        when = (ALWAYS, LOCKSTEP) if values["lockstep"] else (ALWAYS,)
        return self._composed(specs, when) if values["composed"] else specs

    def if_it_ends(self, name: str) -> str:
        """Reaction of the graph to the end of a node: END, GO_ON or RESTART."""
        entry: Mapping[str, Any] = self._nodes.get(name, {})
        return str(entry.get("if_it_ends", END))

    def remappings(self, values: Mapping[str, Any]) -> dict[str, str]:
        """Names of topics that are replaced, as the nodes have them, by other ones."""
        return {
            name: target
            for name, given in self._remappings.items()
            if (target := _value(given, values)) != name
        }

    def about(self, values: Mapping[str, Any]) -> str:
        """The arguments that say how a bag came about, as JSON: the main ones and those changed."""
        return json.dumps(
            {
                a.name: values[a.name]
                for a in self.arguments
                if a.name in ("hardware", "gait", "scene")
                or (
                    a.name not in ("bag", "port")
                    and values[a.name] != a.default
                )
            }
        )

    def _composed(
        self, specs: list[NodeSpec], when: Sequence[str]
    ) -> list[NodeSpec]:
        """The nodes, of which the ones composable at `when` share a process.

        The process has the parameters of all: a parameter of one name has one value.
        """
        inside = [
            spec
            for spec in specs
            if self._nodes[spec.name].get("composable") in when
        ]
        parameters = {
            name: value
            for spec in inside
            for name, value in spec.parameters.items()
        }
        process = replace(
            next(spec for spec in inside if spec.if_it_ends == END),
            name=CONTROLLER,
            parameters=parameters,
            nodes=tuple(spec.name for spec in inside),
        )
        return [*(spec for spec in specs if spec not in inside), process]

    def _parameters(
        self, entry: Mapping[str, Any], values: Mapping[str, Any]
    ) -> dict[str, Any]:
        parameters = {**self._common, **entry.get("parameters", {})}
        for argument, extra in entry.get("parameters_with", {}).items():
            parameters |= extra if values[argument] else {}
        return {
            name: value
            for name, given in parameters.items()
            if (value := _value(given, values)) is not None
        }


def _value(value: Any, values: Mapping[str, Any]) -> Any:
    """A value of `graph.yaml`; $name stands for the value of an argument."""
    return (
        values[value[1:]]
        if isinstance(value, str) and value.startswith("$")
        else value
    )


def _computed(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of `graph.yaml` that are no arguments; None: as the node is configured.

    Unattended, the supervisor starts to walk by itself and needs no e-stop source; attended, it
    waits for requests. The driver and the emulated servos share a port. A camera of the scene
    replaces its odometry, and says what carries it.
    """
    attended, port = is_attended(values), values["port"]
    emulated = values["hardware"] == "fake_bus"
    if emulated and not port:
        port = str(Path(tempfile.gettempdir(), f"slot_bus_{os.getpid()}"))
    computed = {
        "driver_port": port,
        "emulated_port": port if emulated else None,
        "autostart": not attended,
        "estop_required": None if attended else False,
        "best_effort_sensors": values["hardware"] == "real",
        "simulated_time": values["lockstep"] or values["hardware"] == "none",
        "carrier": None,
        "policy": policy_of(values),
    }
    if is_simulated(values):
        camera = read_scene(values["scene"]).sensors.camera
        computed["markers"] = values["markers"] or camera.enabled
        computed["carrier"] = camera.carrier if camera.enabled else None
    return computed


def _priority(values: Mapping[str, Any]) -> dict[str, str]:
    """Environment with the real-time priority of nodes. Empty text: the default, if permitted."""
    wanted = values["realtime"]
    if (
        wanted is None
        and not values["lockstep"]
        and len(os.sched_getaffinity(0)) >= CORES
    ):
        return {"SLOT_PRIORITY": ""}
    return {"SLOT_PRIORITY": str(wanted)} if wanted else {}


def ends_graph(if_it_ends: str, code: int) -> bool:
    """Whether the graph ends with a process that has ended with an exit code.

    One whose configuration is refused has never been of use.
    """
    return if_it_ends == END or code == REFUSED


def absolute(namespace: str) -> str:
    """Namespace with its leading slash."""
    return "/" + namespace.removeprefix("/")


def is_simulated(values: Mapping[str, Any]) -> bool:
    """Whether a simulated robot is started."""
    return values["hardware"] in ("sim", "fake_bus")


def is_attended(values: Mapping[str, Any]) -> bool:
    """Whether the robot stands and walks only at an operator's request.

    Always with real servos, and without odometry, but in lockstep, which has no operator.
    """
    return bool(
        values["attended"]
        or values["hardware"] == "real"
        or (is_blind(values) and not values["lockstep"])
    )


def is_blind(values: Mapping[str, Any]) -> bool:
    """Whether the robot has no odometry."""
    return bool(values["odometry"] == NO_ODOMETRY)


def policy_of(values: Mapping[str, Any]) -> str:
    """Policy of the graph: without odometry the gait alone."""
    return GAIT_ALONE if is_blind(values) else str(values["policy"])


def read_graph() -> Graph:
    """Read the `graph.yaml` of this package."""
    return Graph(
        yaml.safe_load((files("slot_bringup") / "graph.yaml").read_text())
    )
