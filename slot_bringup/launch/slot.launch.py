"""Launch file of the node graph: ros2 launch slot_bringup slot.launch.py gait:=walk."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from slot_bringup.graph import read_graph

GRAPH = read_graph()


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments of `graph.yaml`, then start its nodes."""
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
            OpaqueFunction(function=_start_nodes),
        ]
    )


def _start_nodes(context: LaunchContext) -> list[Node]:
    given = context.launch_configurations
    values = {argument.name: argument.parse(given[argument.name]) for argument in GRAPH.arguments}
    return [
        Node(
            package=spec.package,
            executable=spec.name,
            name=spec.name,
            parameters=[spec.parameters],
            output="screen",
        )
        for spec in GRAPH.nodes(values)
    ]
