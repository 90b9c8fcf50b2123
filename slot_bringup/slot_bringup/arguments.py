"""Arguments of the node graph, and the command line of scripts/run that sets them."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slot_core import config
from slot_core.command_line import CommandParser, within
from slot_core.control.policies import DEFAULT_POLICY, POLICIES
from slot_core.refusal import quoted

PROGRAM = "scripts/run"
ABOUT = (
    "Runs the node graph for a given time, records a bag and prints a summary."
)


@dataclass(frozen=True)
class Argument:
    """Argument that a user may set when starting the graph."""

    name: str
    kind: type
    default: Any
    help: str
    choices: tuple[str, ...] | None = None
    is_path: bool = False  # whether ~ stands for the home directory
    unit: str = ""  # of a number

    @property
    def metavar(self) -> str | None:
        """Placeholder of a value in a help; None where the choices stand."""
        if self.choices:
            return None
        kind = "NAME" if self.kind is str else "N"
        return self.unit or ("FILE" if self.is_path else kind)

    @property
    def text(self) -> str:
        """The default in the text form of a launch argument."""
        return "" if self.default is None else str(self.default)

    def parse(self, text: str) -> Any:
        """Convert a launch argument's text to its value.

        Raises ValueError, which names the argument, where the type is wrong.
        """
        if self.default is None and not text:
            return None
        try:
            value = config.parse(text) if self.kind is bool else self.kind(text)
        except ValueError:
            value = None
        if type(value) is not self.kind:
            raise ValueError(
                f"{self.name} = {quoted(text)}: expected"
                f" {config.KIND_NAMES[self.kind]}"
            )
        return str(Path(text).expanduser()) if self.is_path and text else value


def graph_arguments() -> tuple[Argument, ...]:
    """The arguments in the order of the help; choices from config/ are the names of its files."""
    return (
        Argument(
            "hardware",
            str,
            "sim",
            "what moves the legs: simulated servos, the driver with emulated servos, or with real "
            "ones; none: a bag that is played has the sensors and the clock",
            choices=("sim", "fake_bus", "real", "none"),
        ),
        Argument(
            "port",
            str,
            None,
            "serial port of the servos; default: that of config/dynamixel.yaml, with fake_bus a "
            "new one",
            unit="DEVICE",
        ),
        Argument(
            "gait",
            str,
            "walk",
            f"a gait of config/gait: {', '.join(config.names('gait'))}",
        ),
        Argument(
            "vx",
            float,
            None,
            "forward velocity of the gait, m/s; default: the gait's own",
            unit="M/S",
        ),
        Argument(
            "vy",
            float,
            0.0,
            "lateral velocity of the gait, m/s, left positive",
            unit="M/S",
        ),
        Argument(
            "yaw_rate",
            float,
            0.0,
            "yaw rate of the gait, rad/s, to the left positive",
            unit="RAD/S",
        ),
        Argument(
            "path",
            str,
            "",
            "CSV with columns x, y in odom, m: the path to follow; default: straight ahead",
            is_path=True,
        ),
        Argument(
            "path_heading",
            str,
            "kept",
            "heading on the path: that at the start, or the path's direction",
            choices=("kept", "along"),
        ),
        Argument(
            "policy",
            str,
            DEFAULT_POLICY,
            f"controller: {', '.join(POLICIES)}, a Python file with one, or onnx:FILE, a learned "
            "network",
        ),
        Argument(
            "scene",
            str,
            "flat",
            f"a scene of config/scene: {', '.join(config.names('scene'))}",
        ),
        Argument(
            "markers",
            bool,
            False,
            "marker_localizer makes the odometry from a camera's images; always in a scene with a "
            "camera",
        ),
        Argument(
            "calibration",
            str,
            "",
            "camera file of scripts/calibrate --camera for marker_localizer; default: "
            "/camera/camera_info",
            is_path=True,
        ),
        Argument(
            "odometry",
            str,
            "topic",
            "source of the torso's place; none: a robot without a camera, which stands and walks "
            "by the gait alone, at an operator's request",
            choices=("topic", "none"),
        ),
        Argument(
            "bench",
            bool,
            False,
            "the robot hangs on a bench, feet off the floor: its tilt is not watched; with "
            "odometry none",
        ),
        Argument(
            "odometry_topic",
            str,
            "odom",
            "topic of the odometry, for example that of a visual SLAM",
        ),
        Argument("imu_topic", str, "imu", "topic of the IMU"),
        Argument(
            "stamped_cmd_vel",
            bool,
            True,
            "/cmd_vel is a TwistStamped; else a Twist, as of Nav2 and teleop_twist_keyboard "
            "without options",
        ),
        Argument("seed", int, 0, "seed of the simulated sensors' noise"),
        Argument(
            "lockstep",
            bool,
            False,
            "the simulation waits for every command and for the supervisor: repeatable, not in "
            "real time",
        ),
        Argument(
            "composed",
            bool,
            None,
            "the controller's nodes share one process, in lockstep with robot and supervisor; "
            "default: in lockstep, and where one core carries the controller",
        ),
        Argument(
            "realtime",
            int,
            None,
            "SCHED_FIFO priority of controller, supervisor and simulated robot, 1 to 99, which "
            "then lock their memory; 0: none; default: 50 where the system gives the right to it, "
            "none in lockstep and on one core",
            unit="PRIORITY",
        ),
        Argument(
            "attended",
            bool,
            False,
            "the robot stands and walks only at an operator's request (scripts/operate); always "
            "with real servos",
        ),
        Argument(
            "without",
            str,
            "",
            "nodes that are not started, separated by commas: a lab's own take their place",
            unit="NODES",
        ),
        Argument(
            "params_file",
            str,
            "",
            "parameter file of ROS with settings of the nodes; default: those of config/",
            is_path=True,
        ),
        Argument(
            "bag",
            str,
            "",
            "directory of the bag to record, which must not exist; default: no bag",
            is_path=True,
        ),
        Argument(
            "visualize",
            bool,
            False,
            "publish bent legs, tendons, forces and reference as markers for RViz and Foxglove",
        ),
        Argument(
            "namespace",
            str,
            "",
            "namespace of nodes, topics and services; robots in different ones can share a ROS "
            "domain",
        ),
        Argument(
            "frame_prefix",
            str,
            "",
            "prefix of the frames in every message, for example fred/; default: none",
        ),
    )


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line of scripts/run; a wrong type exits with code 2 and one line."""
    parser = CommandParser(prog=PROGRAM, description=ABOUT)
    for argument in graph_arguments():
        if argument.name == "bag":
            continue
        default = f" (default: {argument.text})" if argument.text else ""
        flag: dict[str, Any] = {"help": argument.help + default}
        if argument.name == "composed":
            flag |= {"action": "store_true", "default": None}
        elif argument.kind is bool:
            flag |= (
                {"action": argparse.BooleanOptionalAction, "default": True}
                if argument.default
                else {"action": "store_true"}
            )
        else:
            flag |= {
                "type": argument.kind,
                "default": argument.default,
                "choices": argument.choices,
                "metavar": argument.metavar,
            }
        parser.add_argument(f"--{argument.name.replace('_', '-')}", **flag)
    add, time = parser.add_argument, within(0.5, 86400.0, "s")
    add(
        "--separate",
        dest="composed",
        action="store_false",
        help="each of the controller's nodes in a process of its own",
    )
    add(
        "--duration",
        type=time,
        default=20.0,
        metavar="S",
        help="length of the run on the robot's clock, from when it may first follow commands, s (default: 20)",
    )
    add(
        "--view",
        action="store_true",
        help="serve the live page of scripts/play --graph while it runs",
    )
    keep = parser.add_mutually_exclusive_group()
    keep.add_argument(
        "--bag",
        type=Path,
        metavar="DIR",
        help="directory for bag, logs, summary and plots (default: bags/GAIT_DATE_TIME)",
    )
    keep.add_argument(
        "--no-bag",
        action="store_true",
        help="write nothing, only print the summary",
    )
    return parser.parse_args(arguments)
