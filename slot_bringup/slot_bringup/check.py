"""Check of the graph's arguments before any node starts, for scripts/run and the launch file."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.exceptions import NameValidationException
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_topic_name import validate_topic_name

from slot_bringup.graph import absolute, is_blind, is_simulated, read_graph
from slot_core import config
from slot_core.config import ConfigError
from slot_core.control.force_map import read_force_map
from slot_core.control.policies import DEFAULT_POLICY, GAIT_ALONE
from slot_core.control.policy import policy_class
from slot_core.dynamics.scene import read_scene
from slot_core.estimation.state_estimator import read_estimator
from slot_core.faults import require_simulated_legs
from slot_core.gait.gait import gait_misfit, read_gaits
from slot_core.gait.route import read_route
from slot_core.legs.leg_table import require_own_leg_map
from slot_core.refusal import nearest, quoted
from slot_core.robot import read_robot
from slot_core.ros_parameters import read_parameters
from slot_core.safety.settings import read_supervisor
from slot_core.servos.registry import read_brand
from slot_core.vision.settings import read_vision

# Settings of the nodes, which a parameter file may change.
SETTINGS: dict[str, Callable[[Mapping[str, Any]], Any]] = {
    "state_estimator": lambda _: read_estimator(),
    "gait_scheduler": lambda _: read_gaits(),
    "mpc_controller": lambda v: policy_class(v["policy"]).read_settings(
        v["policy"]
    ),
    "force_mapper": lambda _: read_force_map(),
    "supervisor": lambda _: read_supervisor(),
    "marker_localizer": lambda _: read_vision(),
    "dynamixel_driver": lambda _: read_brand().read_settings(),
}
OF_EVERY_NODE = ("use_sim_time",)  # set by the graph
PRIORITY_MAX = os.sched_get_priority_max(os.SCHED_FIFO)
DOMAIN_MAX = 232  # beyond it the ports of DDS, 7400 + 250 domain, exceed 65535


def check(values: Mapping[str, Any]) -> list[str]:
    """Remarks on values of the graph's arguments, by name, lines.

    Raises ConfigError for those that a node would refuse, and for settings that one would.
    """
    settings = {
        name: read(values)
        for name, read in SETTINGS.items()
        if name != "dynamixel_driver"
        or values["hardware"] in ("fake_bus", "real")
    }
    gaits, robot = settings["gait_scheduler"], read_robot()
    gait = gaits.find(values["gait"])
    v_x = gait.cruise if values["vx"] is None else values["vx"]
    velocity = np.array([v_x, values["vy"], values["yaw_rate"]])
    gaits.require_velocity(values["gait"], velocity)
    if values["path"]:
        read_route(Path(values["path"]), values["path_heading"])
        if not velocity[:2].any():
            raise ConfigError(
                f"path: gait {values['gait']} with this velocity stays in its place"
            )
    scene = read_scene(values["scene"])
    _check_nodes(values["without"])
    if values["lockstep"]:
        _check_lockstep(values)
    _check_odometry(values)
    if (
        values["markers"]
        and is_simulated(values)
        and not scene.sensors.camera.enabled
    ):
        raise ConfigError(f"markers: the scene {values['scene']} has no camera")
    if values["calibration"]:
        _check_calibration(Path(values["calibration"]))
    for name in ("odometry_topic", "imu_topic"):
        _check_name(name, values[name], validate_topic_name)
    if values["hardware"] == "sim":
        for fault in scene.faults.values():
            require_simulated_legs(fault)
    _check_ranges(values)
    port = values["port"]
    if (
        values["hardware"] == "fake_bus"
        and port is not None
        and not Path(port).parent.is_dir()
    ):
        raise ConfigError(f"port {port}: not in an existing directory")
    check_place(values["namespace"])
    if values["params_file"]:
        _check_parameters(values)
    _check_prefix(values["frame_prefix"])
    if values["bag"]:
        _check_new(Path(values["bag"]))
    remarks = (require_own_leg_map(robot), gait_misfit(values["gait"], robot))
    return [*filter(None, remarks)]


def _check_nodes(without: str) -> None:
    """Raise ConfigError for a name among some, separated by commas, that no node has."""
    known = read_graph().names
    for name in filter(None, without.split(",")):
        if name not in known:
            raise ConfigError(
                f"without = {quoted(name)}: expected names among {', '.join(known)}"
            )


def _check_parameters(values: Mapping[str, Any]) -> None:
    """Raise ConfigError for a parameter file with a node, a name or a value that does not fit.

    ROS itself ignores names that it does not know.
    """
    file = Path(values["params_file"])
    nodes = {
        f"{absolute(values['namespace']).rstrip('/')}/{name}": name
        for name in SETTINGS
    }
    for given in read_parameters(file):
        matched = [nodes[full] for full in nodes if given.match(full)]
        if not matched:
            raise ConfigError(
                f"params_file {file}: {given.pattern} has no settings (known:"
                f" {', '.join(nodes)})"
            )
        known = set(OF_EVERY_NODE)
        for name in matched:
            settings = SETTINGS[name](values)
            leaves = {leaf for leaf, _, _ in config.leaves(settings)}
            config.replace(
                settings,
                {x: given.values[x] for x in leaves & given.values.keys()},
                f"params_file {file}: {name}",
            )
            known |= leaves
        for name in given.values:
            if name not in known and not name.startswith("qos_overrides."):
                raise ConfigError(
                    f"params_file {file}: {given.pattern}: {name} is not a setting"
                    f"{nearest(name, sorted(known))}"
                )


def _check_lockstep(values: Mapping[str, Any]) -> None:
    """Raise ConfigError for arguments that lockstep excludes."""
    if not is_simulated(values):
        raise ConfigError(
            f"lockstep: servos of hardware {values['hardware']} move in real time"
        )
    if values["attended"]:
        raise ConfigError(
            "lockstep: an operator and the e-stop's source live in real time"
        )
    if values["port"] is not None:
        raise ConfigError("port: emulated servos have none in lockstep")
    if not read_scene(values["scene"]).sensors.imu.enabled:
        raise ConfigError(
            f"lockstep: the scene {values['scene']} has no IMU, whose samples are the clock"
        )


def _check_odometry(values: Mapping[str, Any]) -> None:
    """Raise ConfigError for arguments that need odometry, or that there is none."""
    if not is_blind(values):
        if values["bench"]:
            raise ConfigError("bench: needs odometry none")
        return
    if values["policy"] not in (DEFAULT_POLICY, GAIT_ALONE):
        raise ConfigError(
            f"policy = {quoted(values['policy'])}: odometry none leaves {GAIT_ALONE} alone"
        )
    for name in ("path", "markers"):
        if values[name]:
            raise ConfigError(f"{name}: needs odometry, which is none")


def _check_ranges(values: Mapping[str, Any]) -> None:
    """Raise ConfigError for a number outside its range."""
    if not 0 <= values["seed"] < 2**63:
        raise ConfigError(f"seed = {values['seed']}: outside [0, {2**63 - 1}]")
    if (
        values["realtime"] is not None
        and not 0 <= values["realtime"] <= PRIORITY_MAX
    ):
        raise ConfigError(
            f"realtime = {values['realtime']}: outside [0, {PRIORITY_MAX}]"
        )


def check_place(namespace: str) -> None:
    """Raise ConfigError for a namespace (empty: none), a domain or keys that ROS refuses."""
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (domain.isdecimal() and int(domain) <= DOMAIN_MAX):
        raise ConfigError(
            f"ROS_DOMAIN_ID = {quoted(domain)}: expected a number within [0, {DOMAIN_MAX}]"
        )
    _check_name(
        "namespace", namespace, lambda name: validate_namespace(absolute(name))
    )
    if os.environ.get("ROS_SECURITY_ENABLE") == "true":
        _check_keys()


def _check_keys() -> None:
    """Raise ConfigError where SROS2 does not find its keys."""
    context = Context()
    try:
        rclpy.init(
            args=[],
            context=context,
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except RuntimeError as error:  # an RCLError
        store = quoted(os.environ.get("ROS_SECURITY_KEYSTORE", ""))
        reason, _, _ = str(error).partition(", at ")  # a line of rcl
        raise ConfigError(
            f"ROS_SECURITY_ENABLE = true with ROS_SECURITY_KEYSTORE = {store}:"
            f" {reason}; set a keystore, or unset both"
        ) from None
    context.try_shutdown()


def _check_prefix(prefix: str) -> None:
    """Raise ConfigError for a prefix of frames that is neither empty nor like fred/."""
    if prefix.startswith("/"):
        reason = "tf2 knows no frames that begin with a slash"
    elif prefix and not prefix.endswith("/"):
        reason = f"expected one that ends with a slash, {prefix[:20]}/"
    else:
        return
    raise ConfigError(f"frame_prefix = {quoted(prefix)}: {reason}")


def _check_calibration(file: Path) -> None:
    """Raise ConfigError for a file that is no calibration of a camera."""
    from slot_core.vision.camera import CameraError, read_camera  # noqa: PLC0415 - OpenCV

    try:
        read_camera(file)
    except CameraError as error:
        raise ConfigError(f"calibration {error}") from None


def _check_name(
    argument: str, name: str, validate: Callable[[str], Any]
) -> None:
    """Raise ConfigError for a name that ROS does not allow."""
    try:
        validate(name)
    except NameValidationException as error:
        raise ConfigError(
            f"{argument} = {quoted(name)}: {str(error).splitlines()[0]}"
        ) from None


def _check_new(bag: Path) -> None:
    """Raise ConfigError if no bag can be made at a path."""
    try:
        exists = bag.exists()
    except OSError as error:
        raise ConfigError(f"bag: {error.strerror}") from None
    if exists:
        raise ConfigError(f"bag {bag}: exists already")
