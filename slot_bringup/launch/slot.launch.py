"""Launch file of the node graph: ros2 launch slot_bringup slot.launch.py gait:=walk."""

import sys
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
)
from launch import Action, LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from slot_bringup import composition
from slot_bringup.check import check
from slot_bringup.graph import (
    GO_ON,
    RESTART,
    RESTARTS,
    TIED,
    ends_graph,
    read_graph,
)
from slot_bringup.monitor import require_no_other_graph
from slot_bringup.stock_recorder import record_command
from slot_core.config import ConfigError

GRAPH = read_graph()
# processes of this file alone
STOCK_RECORDER, MODEL = ("ros2bag", "robot_state_publisher")
ADDED = {STOCK_RECORDER: GO_ON, MODEL: RESTART}
# Arguments of this file alone: default, what it chooses, choices.
OWN = {
    "recorder": (
        "slot",
        "what records the bag: the own node, or ros2 bag record",
        ("slot", "ros2bag"),
    ),
    "robot_description": (
        "true",
        "robot_state_publisher publishes the URDF",
        ("true", "false"),
    ),
}
OF_LAUNCH = ("launch-prefix", "launch-prefix-filter")  # of ros2 launch itself


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments of the graph, then start its nodes."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(
                    argument.name,
                    default_value=argument.text,
                    description=argument.help,
                    choices=argument.choices,
                )
                for argument in GRAPH.arguments
            ),
            *(
                DeclareLaunchArgument(
                    name, default_value=text, description=what, choices=choices
                )
                for name, (text, what, choices) in OWN.items()
            ),
            OpaqueFunction(function=_start_nodes),
            RegisterEventHandler(OnProcessExit(on_exit=_end)),
        ]
    )


def _start_nodes(context: LaunchContext) -> list[Action]:
    _require_known(context.argv)
    given = context.launch_configurations
    values = {
        argument.name: argument.parse(given[argument.name])
        for argument in GRAPH.arguments
    }
    remarks = check(values)
    require_no_other_graph(values["namespace"])
    values["composed"], choice = composition.choose(values)
    said = [LogInfo(msg=line) for line in [*remarks, choice] if line]
    stock = (
        [_stock_recorder(values)]
        if given["recorder"] == "ros2bag" and values["bag"]
        else []
    )
    if stock:
        # no node that records, and no robot that waits for it
        values |= {"bag": ""}
    model = _robot_model(values) if given["robot_description"] == "true" else []
    return [*said, *stock, *model] + [
        Node(
            package=spec.package,
            executable=spec.name,
            name=spec.node_name,
            arguments=list(spec.nodes),
            exec_name=spec.name,  # in the log, else that of the prefix
            namespace=spec.namespace,
            remappings=list(spec.remappings.items()),
            parameters=[
                *filter(None, [spec.params_file]),
                {
                    name: _typed(value)
                    for name, value in spec.parameters.items()
                },
            ],
            prefix=" ".join(TIED),  # launch leaves its nodes running at SIGTERM
            additional_env=dict(spec.environment),
            output="screen",
            respawn=spec.if_it_ends == RESTART,
            respawn_max_retries=RESTARTS,
        )
        for spec in GRAPH.nodes(values)
    ]


def _require_known(words: list[str]) -> None:
    """Raise ConfigError for an argument NAME:=VALUE that is none; launch itself ignores it.

    Not where a launch file of the user's own includes this one: the arguments are its own then.
    """
    ours = {path.name for path in Path(__file__).parent.glob("*.launch.py")}
    if ours.isdisjoint(Path(word).name for word in sys.argv):
        return
    known = [*(argument.name for argument in GRAPH.arguments), *OWN, *OF_LAUNCH]
    for name in (word.partition(":=")[0] for word in words):
        if name not in known:
            # all: too long
            near = (
                ", ".join(get_close_matches(name, known, cutoff=0.7)) or "none"
            )
            raise ConfigError(
                f"no argument {name!r} (similar: {near}; --show-args lists all)"
            )


def _stock_recorder(values: dict[str, Any]) -> ExecuteProcess:
    """`ros2 bag record` of the same topics."""
    command = record_command(
        values["bag"],
        values["namespace"],
        GRAPH.about(values),
        GRAPH.remappings(values),
        best_effort_sensors=values["hardware"] == "real",
    )
    return ExecuteProcess(
        cmd=[*TIED, *command], name=STOCK_RECORDER, output="screen"
    )


def _robot_model(values: dict[str, Any]) -> list[Action]:
    """The node that publishes the URDF and the frames of its links, where it is installed."""
    try:
        get_package_prefix(MODEL)
    except PackageNotFoundError:
        return [
            LogInfo(
                msg=f"{MODEL} is not installed, so there is no /robot_description"
            )
        ]
    urdf = Path(
        get_package_share_directory("slot_bringup"), "urdf", "slot.urdf"
    ).read_text()
    return [
        Node(
            package=MODEL,
            executable=MODEL,
            name=MODEL,
            exec_name=MODEL,
            namespace=values["namespace"],
            parameters=[
                {
                    "robot_description": _typed(urdf),
                    "frame_prefix": _typed(values["frame_prefix"]),
                }
            ],
            prefix=" ".join(TIED),
            output="screen",
            respawn=True,
            respawn_max_retries=RESTARTS,
        )
    ]


def _typed(value: Any) -> Any:
    """The value of a parameter; launch would read a text such as 1e3 as a number."""
    return (
        ParameterValue(value, value_type=str)
        if isinstance(value, str)
        else value
    )


def _end(event: Any, context: LaunchContext) -> list[Action]:
    """End the launch with an exit code other than 0 when a process ends that the graph needs."""
    if context.is_shutdown:
        return []
    line = f"{event.process_name} ended with exit code {event.returncode}"
    name = event.process_name.rpartition("-")[0]  # launch adds a number
    if ends_graph(ADDED.get(name) or GRAPH.if_it_ends(name), event.returncode):
        raise RuntimeError(line)
    return [
        LogInfo(msg=f"{line}; the robot goes on without it, or with a new one")
    ]
