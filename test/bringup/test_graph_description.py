"""Graph description, and the launch file that starts it.

The launcher's choice between one process for the controller's nodes and one for each.

Parameters for Nav2 against what the robot reaches, its frames, topics and size.

Programs in a terminal in which scripts/env was not sourced.
"""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import ament_index_python.packages
import numpy as np
import pytest
import yaml

from slot_bringup import composition
from slot_bringup.arguments import parse
from slot_bringup.check import check
from slot_bringup.graph import END, GO_ON, REFUSED, RESTART, read_graph
from slot_bringup.processes import command_line
from slot_core import config
from slot_core.config import ConfigError
from slot_core.gait.gait import read_gaits
from slot_core.recording.record_settings import read_record_settings
from slot_core.robot import read_robot
from slot_core.safety.settings import read_supervisor

PARAMETERS = Path(__file__).parent / "params.yaml"
SHARE = Path(__file__).resolve().parents[2] / "slot_bringup"


@pytest.fixture
def graph():
    return read_graph()


def values(graph, **changes):
    return {a.name: a.default for a in graph.arguments} | changes


def nodes_of(graph, **changes):
    """Nodes by name, for values of the arguments that are not the default."""
    return {spec.name: spec for spec in graph.nodes(values(graph, **changes))}


def test_the_recorder_runs_only_with_a_bag_and_the_localiser_with_a_camera(
    graph,
):
    plain = [*nodes_of(graph)]
    assert not {"recorder", "marker_localizer"} & {*plain}
    assert [*nodes_of(graph, bag="x")] == ["recorder", *plain]
    localizer = nodes_of(graph, scene="marker_camera")["marker_localizer"]
    assert localizer.parameters["carrier"] == "torso"
    real = nodes_of(graph, hardware="real", markers=True)["marker_localizer"]
    assert "carrier" not in real.parameters  # as vision.yaml has it


@pytest.mark.parametrize(
    ("changes", "name", "word"),
    [
        ({}, "supervisor", 'gait:="walk"'),
        ({"vx": 0.05}, "supervisor", "v_x:=0.05"),
        ({"seed": 3}, "sim_robot", "seed:=3"),
        ({"lockstep": True}, "supervisor", "lockstep:=true"),
        ({"lockstep": True}, "force_mapper", "use_sim_time:=true"),
        (
            {"bag": "x", "stamped_cmd_vel": False},
            "recorder",
            "stamped_cmd_vel:=false",
        ),
        (
            {"stamped_cmd_vel": False},
            "gait_scheduler",
            "stamped_cmd_vel:=false",
        ),
        ({"odometry_topic": "/slam"}, "state_estimator", "odom:=/slam"),
        ({"odometry_topic": "/slam"}, "sim_robot", "odom:=/slam"),
        ({"namespace": "fred"}, "mpc_controller", "__ns:=/fred"),
        ({"namespace": "/fred"}, "mpc_controller", "__ns:=/fred"),
        ({"namespace": "fred"}, "sim_robot", "/clock:=clock"),
        ({"frame_prefix": "fred/"}, "sim_robot", 'frame_prefix:="fred/"'),
    ],
)
def test_an_argument_reaches_its_node_in_the_yaml_that_ros_parses(
    graph, changes, name, word
):
    assert word in command_line(nodes_of(graph, **changes)[name])


@pytest.mark.parametrize(
    ("hardware", "lockstep"),
    [
        ("sim", False),
        ("fake_bus", False),
        ("real", False),
        ("sim", True),
        ("fake_bus", True),
    ],
)
def test_composed_nodes_share_a_process_and_keep_their_parameters(
    graph, hardware, lockstep
):
    """In lockstep robot, supervisor and recorder too; the driver, whose watchdog outlives them, never."""
    given = {"hardware": hardware, "lockstep": lockstep, "vx": 0.05, "bag": "x"}
    chosen = values(graph, policy="paper_text", **given)
    separate = {s.name: s for s in graph.nodes(chosen)}
    chosen["composed"] = True
    *others, process = graph.nodes(chosen)
    separate["recorder"].parameters["about"] = graph.about(chosen)
    shared = [
        "state_estimator",
        "gait_scheduler",
        "mpc_controller",
        "force_mapper",
    ]
    shared += ["sim_robot", "supervisor", "recorder"] if lockstep else []
    assert sorted(process.nodes) == sorted(shared)
    alone = [name for name in separate if name not in process.nodes]
    assert [s.name for s in others] == alone
    for name in process.nodes:
        assert separate[name].parameters.items() <= process.parameters.items()
    line = command_line(process)
    assert line[1 : 1 + len(process.nodes)] == list(process.nodes)
    assert not any(word.startswith("__node") for word in line)


def test_the_nodes_that_the_walk_waits_for_get_the_real_time_priority(graph):
    given = {"hardware": "fake_bus", "realtime": 50}
    nodes = nodes_of(graph, bag="x", visualize=True, **given)
    waits = {
        n for n, s in nodes.items() if s.environment == {"SLOT_PRIORITY": "50"}
    }
    shared = nodes_of(graph, composed=True, **given)["controller"].nodes
    assert waits == {*shared, "dynamixel_driver", "supervisor", "sim_robot"}


def test_hardware_decides_who_has_the_port_the_sensors_and_the_operator(graph):
    """An attended simulation waits for an operator like the real robot."""
    emulated = nodes_of(graph, hardware="fake_bus")
    port = emulated["dynamixel_driver"].parameters["bus.port"]
    assert port
    assert emulated["sim_robot"].parameters["bus"] == port
    real = nodes_of(graph, hardware="real", port="/dev/ttyUSB7")
    assert "sim_robot" not in real
    assert real["dynamixel_driver"].parameters["bus.port"] == "/dev/ttyUSB7"
    assert real["state_estimator"].parameters["best_effort_sensors"] is True
    operated = real["supervisor"].parameters
    assert operated["autostart"] is False
    assert "estop_required" not in operated  # as in config/
    for hardware in ("sim", "fake_bus"):
        attended = nodes_of(graph, hardware=hardware, attended=True)
        assert attended["supervisor"].parameters == operated
    blind = nodes_of(graph, odometry="none")
    assert blind["supervisor"].parameters == operated
    assert blind["mpc_controller"].parameters["policy"] == "gait_alone"
    assert blind["state_estimator"].parameters["odometry.source"] == "none"
    played = nodes_of(graph, hardware="none", bag="somewhere")
    assert not {"sim_robot", "dynamixel_driver"} & played.keys()
    assert {"recorder", "state_estimator", "supervisor"} <= played.keys()
    assert all(
        spec.parameters["use_sim_time"] is True for spec in played.values()
    )


def test_a_parameter_file_comes_before_the_arguments_of_the_graph(graph):
    given = values(graph, params_file=str(PARAMETERS))
    check(given)
    for spec in graph.nodes(given):
        words = command_line(spec)
        assert words.index("--params-file") < words.index("-p")
        assert words[words.index("--params-file") + 1] == str(PARAMETERS)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "mpc: {ros__parameters: {a: 1}}",
            r"/mpc has no settings \(known: /state_estimator, ",
        ),
        (
            "mpc_controller: {ros__parameters: {cost.tild: 1}}",
            r"/mpc_controller: cost\.tild is not a setting \(nearest: cost\.tilt",
        ),
        (
            "'/**': {ros__parameters: {cost: {tilt: -1.0}}}",
            r"mpc_controller\.cost\.tilt = -1\.0: outside \[0\.0001, 10\] rad",
        ),
        (
            "/fred: {supervisor: {ros__parameters: {arrived: 0.1}}}",
            "/fred/supervisor has no set",
        ),
        ("supervisor: 3", "/supervisor: expected a mapping of nodes"),
        ("{}", "no ros__parameters"),
    ],
)
def test_a_parameter_file_that_no_node_would_follow_is_refused(
    graph, tmp_path, text, reason
):
    file = tmp_path / "params.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=rf"^params_file {file}.*{reason}"):
        check(values(graph, params_file=str(file)))


def test_settings_that_a_node_would_refuse_are_refused_before_any_starts(
    graph, tmp_path, monkeypatch
):
    shutil.copytree(config.config_dir(), tmp_path, dirs_exist_ok=True)
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))
    (tmp_path / "servo_bus.yaml").write_text("brand: acme")
    check(values(graph))  # which has no driver
    for hardware in ("fake_bus", "real"):
        with pytest.raises(ConfigError, match=r"brand = 'acme': expected one"):
            check(values(graph, hardware=hardware))
    (tmp_path / "supervisor.yaml").write_text("{}")
    with pytest.raises(ConfigError, match=r"supervisor\.yaml: .* is missing"):
        check(values(graph))


def test_the_launch_file_starts_the_nodes_of_the_description(
    graph, monkeypatch
):
    """Against stubs of launch and launch_ros, which are not among the Python wheels."""
    choice = (False, "controller in four processes: it is large")
    monkeypatch.setattr("slot_bringup.composition.choose", lambda _: choice)
    given = {
        "composed": "",
        "bag": "somewhere",
        "gait": "stand",
        "vx": "0.0",
        "namespace": "fred",
        "params_file": str(PARAMETERS),
        "realtime": "0",
        "visualize": "true",
    }
    asked = []
    said, *started = load_launch_file(monkeypatch, given, asked)
    assert said["msg"] == choice[1]
    assert asked == ["fred"]
    typed = given | {
        "vx": 0.0,
        "realtime": 0,
        "composed": False,
        "visualize": True,
    }
    for node, spec in zip(
        started, graph.nodes(values(graph, **typed)), strict=True
    ):
        # launch would read a text such as 1e3 as a number
        texts = {n: v for n, v in spec.parameters.items() if isinstance(v, str)}
        wrapped = {
            n: {"args": (v,), "value_type": str} for n, v in texts.items()
        }
        expected = {
            "package": spec.package,
            "executable": spec.name,
            "name": spec.name,
            "exec_name": spec.name,
            "namespace": "fred",
            "remappings": [("/clock", "clock")],
            "prefix": "setpriv --pdeathsig TERM",
            "respawn": spec.name == "visualizer",
            "parameters": [str(PARAMETERS), spec.parameters | wrapped],
        }
        assert node | expected == node


@pytest.mark.parametrize("hardware", ["sim", "real"])
def test_the_launch_file_records_the_same_topics_with_ros2_bag(
    monkeypatch, tmp_path, hardware
):
    """With the quality of service of the own recorder."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    given = {
        "bag": "somewhere",
        "namespace": "fred",
        "odometry_topic": "/rtabmap/odom",
        "recorder": "ros2bag",
        "hardware": hardware,
    }
    stock, *nodes = load_launch_file(monkeypatch, given)
    assert "recorder" not in {node["name"] for node in nodes}
    words, settings = stock["cmd"], read_record_settings("fred")
    assert words[:6] == [
        "setpriv",
        "--pdeathsig",
        "TERM",
        "ros2",
        "bag",
        "record",
    ]
    options, topics = (
        part.split() for part in " ".join(words).split(" --topics ")
    )
    renamed = {"/fred/odom": "/rtabmap/odom"}
    assert topics == [renamed.get(topic, topic) for topic in settings.topics]
    assert any(word.startswith("revision=") for word in options)
    assert {f"hardware={hardware}", "namespace=fred", "gait=walk"} <= {*options}
    file = Path(options[options.index("--qos-profile-overrides-path") + 1])
    profiles = yaml.safe_load(file.read_text())
    assert [*profiles] == sorted(topics)
    assert {profile["depth"] for profile in profiles.values()} == {
        settings.depth
    }
    plan, sensor = profiles["/fred/tendon_plan"], profiles["/rtabmap/odom"]
    assert (plan["reliability"], plan["durability"]) == (
        "reliable",
        "transient_local",
    )
    assert (sensor["reliability"] == "best_effort") == (hardware == "real")


NEEDLESS = [
    "recorder",
    "visualizer",
    "rosbag2_recorder",
    "robot_state_publisher",
]


def test_the_supervisor_says_the_end_of_every_process_without_which_the_graph_goes_on(
    graph,
):
    specs = graph.nodes(values(graph, bag="somewhere", visualize=True))
    ends = {s.name: s.if_it_ends for s in specs if s.if_it_ends != END}
    assert ends == {"recorder": GO_ON, "visualizer": RESTART}
    assert {*read_supervisor().companions} == {*NEEDLESS}


@pytest.mark.parametrize(
    "name", [*NEEDLESS[:2], "ros2bag", "robot_state_publisher"]
)
def test_a_launch_goes_on_without_a_process_that_it_does_not_need(
    monkeypatch, name
):
    end = graph_launch_file(monkeypatch)[-1]["args"][0]["on_exit"]
    running = SimpleNamespace(is_shutdown=False)
    [said] = end(
        SimpleNamespace(process_name=f"{name}-1", returncode=-9), running
    )
    line = f"{name}-1 ended with exit code -9; the robot goes on"
    assert said["msg"].startswith(line)
    for needed, code in ((name, REFUSED), ("mpc_controller", -9)):
        line = f"{needed}-1 ended with exit code {code}"
        with pytest.raises(RuntimeError, match=line):
            end(
                SimpleNamespace(process_name=f"{needed}-1", returncode=code),
                running,
            )


@pytest.mark.parametrize("installed", [True, False])
def test_the_launch_file_starts_the_urdfs_publisher_where_there_is_one(
    monkeypatch, installed
):
    """Also without `visualize`."""
    packages = ament_index_python.packages
    fault = None if installed else packages.PackageNotFoundError("absent")
    find = Mock(return_value="/found", side_effect=fault)
    monkeypatch.setattr(packages, "get_package_prefix", find)
    monkeypatch.setattr(
        packages, "get_package_share_directory", lambda _: str(SHARE)
    )
    given = {
        "robot_description": "true",
        "namespace": "fred",
        "frame_prefix": "fred/",
    }
    model, *_ = load_launch_file(monkeypatch, given)
    if not installed:
        assert "robot_state_publisher is not installed" in model["msg"]
        return
    assert (model["package"], model["namespace"]) == (
        "robot_state_publisher",
        "fred",
    )
    (parameters,) = model["parameters"]
    assert parameters["frame_prefix"]["args"] == ("fred/",)
    assert '<robot name="slot">' in parameters["robot_description"]["args"][0]


def record(*args, **kwargs):
    """Stub of the classes of launch."""
    return kwargs | {"args": args}


def run_launch_file(monkeypatch, name, **stubs):
    """Run a launch file against stubs of modules, as names of their classes; its actions."""
    for module, members in stubs.items():
        stub = SimpleNamespace(**dict.fromkeys(members.split(), record))
        monkeypatch.setitem(sys.modules, module.replace("__", "."), stub)
    path = SHARE / "launch" / f"{name}.launch.py"
    return runpy.run_path(str(path))["generate_launch_description"]()["args"][0]


@pytest.mark.parametrize(
    ("program", "given", "words", "fault"),
    [
        (
            "slot",
            {},
            ["gaits:=walk"],
            "'gaits' (similar: gait; --show-args lists all)",
        ),
        (
            "d435_rtabmap",
            {},
            ["imu:=x"],
            "'imu' (similar: none; --show-args lists all)",
        ),
        (
            "slot",
            {},
            ["gait:=walk", "recorder:=slot", "launch-prefix:=gdb"],
            "",
        ),
        # of a user's own, which includes ours
        (
            "whole_fleet",
            {},
            ["robots:=3"],
            "",
        ),
        ("slot", {"vx": "9"}, [], "v_x = 9: gait walk reaches"),
        ("slot", {"bag": "~"}, [], "exists already"),
        (
            "slot",
            {"markers": "true"},
            [],
            "markers: the scene flat has no camera",
        ),
        (
            "slot",
            {"calibration": "no.yaml"},
            [],
            "calibration no.yaml: No such file",
        ),
        (
            "slot",
            {"odometry_topic": "a b"},
            [],
            "odometry_topic = 'a b': Invalid topic",
        ),
        ("slot", {"imu_topic": ""}, [], "imu_topic = '': Invalid topic name"),
        ("slot", {"realtime": "100"}, [], "realtime = 100: outside [0, 99]"),
        ("slot", {"vx": "fast"}, [], "vx = 'fast': expected a number"),
        ("slot", {"seed": "1.5"}, [], "seed = '1.5': expected a whole number"),
        ("slot", {"seed": ""}, [], "seed = '': expected a whole number"),
        (
            "slot",
            {"lockstep": "perhaps"},
            [],
            "lockstep = 'perhaps': expected true or f",
        ),
    ],
)
def test_the_launch_file_refuses_what_scripts_run_refuses_and_unknown_arguments(
    monkeypatch, program, given, words, fault
):
    line = ["ros2", "launch", "slot_bringup", f"{program}.launch.py", *words]
    monkeypatch.setattr(sys, "argv", line)
    with (
        pytest.raises(ValueError, match=re.escape(fault))
        if fault
        else nullcontext()
    ):
        load_launch_file(monkeypatch, given, words=words)


@pytest.mark.parametrize(
    ("name", "packages"),
    [
        ("d435_rtabmap", ["realsense2_camera", "rtabmap_launch"]),
        ("d435_isaac_vslam", ["realsense2_camera"]),
    ],
)
def test_a_camera_with_a_visual_slam_brings_up_the_graph_on_its_topics(
    graph, monkeypatch, name, packages
):
    """Against stubs: neither launch nor the packages of the camera are among the wheels."""
    actions = run_launch_file(
        monkeypatch,
        name,
        launch="LaunchDescription",
        launch_ros="",
        launch__actions="DeclareLaunchArgument GroupAction IncludeLaunchDescription",
        launch__launch_description_sources="PythonLaunchDescriptionSource",
        launch__substitutions="PathJoinSubstitution",
        launch_ros__actions="ComposableNodeContainer SetParameter",
        launch_ros__descriptions="ComposableNode",
        launch_ros__substitutions="FindPackageShare",
    )
    listed = [a["args"][0] for a in actions if a.get("args")]
    *others, own = [
        g[-1]["args"][0]["args"][0] for g in listed if type(g) is list
    ]
    # of FindPackageShare
    assert [place["args"][0][0]["args"][0] for place in others] == packages
    assert Path(own).name == "slot.launch.py"
    given = {
        a["args"][0]: a["default_value"]
        for a in actions
        if "default_value" in a
    }
    assert {"odometry_topic", "imu_topic"} < set(given)
    for spec in graph.nodes(values(graph, **given)):
        assert f"odom:={given['odometry_topic']}" in command_line(spec)
        assert f"imu:={given['imu_topic']}" in command_line(spec)
    check(values(graph, **given))


def graph_launch_file(monkeypatch):
    """Actions of launch/slot.launch.py."""
    return run_launch_file(
        monkeypatch,
        "slot",
        launch="Action LaunchContext LaunchDescription",
        launch_ros="",
        launch__actions="DeclareLaunchArgument ExecuteProcess LogInfo OpaqueFunction "
        "RegisterEventHandler",
        launch__event_handlers="OnProcessExit",
        launch_ros__actions="Node",
        launch_ros__parameter_descriptions="ParameterValue",
    )


def load_launch_file(monkeypatch, given, asked=None, words=()):
    """Run launch/slot.launch.py with launch arguments; return the arguments of its nodes.

    asked: gets the namespaces in which it looks for another graph. words: of the command line.
    """
    note = (lambda _: None) if asked is None else asked.append
    monkeypatch.setattr("slot_bringup.monitor.require_no_other_graph", note)
    *arguments, start, _ = graph_launch_file(monkeypatch)
    texts = {a["args"][0]: a["default_value"] for a in arguments}
    texts |= {"robot_description": "false", "composed": "false"} | given
    return start["function"](
        SimpleNamespace(launch_configurations=texts, argv=words)
    )


@pytest.mark.parametrize(
    ("cores", "load", "line"),
    [
        (2.0, 0.395, "one process: its load is 0.79 of a core, limit 0.8"),
        (2.0, 0.405, "four processes: its load is 0.81 of a core, limit 0.8"),
        (1.5, 2.0, "one process: 1.5 cores for the graph, less than 2"),
        (
            2.0,
            ValueError("no sensor"),
            "four processes: its policy fails, ValueError: no sensor",
        ),
    ],
)
def test_the_controller_has_one_process_where_one_core_carries_it_or_there_is_no_second(
    monkeypatch, cores, load, line
):
    monkeypatch.setattr(composition, "available_cores", lambda: cores)
    monkeypatch.setattr(composition, "core_load", Mock(side_effect=[load]))
    chosen = composition.choose(vars(parse([])))
    assert chosen == (line.startswith("one"), f"controller in {line}")


@pytest.mark.parametrize(
    ("words", "composed"),
    [
        (["--composed"], True),
        (["--separate"], False),
        (["--lockstep"], True),
        (["--lockstep", "--separate"], False),
    ],
)
def test_what_is_asked_for_is_not_measured(monkeypatch, words, composed):
    monkeypatch.setattr(composition, "core_load", None)  # cannot be called
    assert composition.choose(vars(parse(words))) == (composed, "")


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({}, 3.0),
        ({"cpu.max": "150000 100000"}, 1.5),
        ({"cpu.max": "900000 100000"}, 3.0),
        ({"cpu.max": "max 100000"}, 3.0),
        (
            {
                "cpu/cpu.cfs_quota_us": "50000",
                "cpu/cpu.cfs_period_us": "100000",
            },
            0.5,
        ),
        (
            {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"},
            3.0,
        ),
    ],
)
def test_cores_are_those_of_the_affinity_within_the_quota_of_the_container(
    monkeypatch, tmp_path, files, cores
):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 2, 5})
    (tmp_path / "cpu").mkdir()
    for name, text in files.items():
        (tmp_path / name).write_text(f"{text}\n")
    assert composition.available_cores(tmp_path) == cores


def test_the_load_is_the_cpu_time_of_the_ticks_over_their_period(monkeypatch):
    """A clock that goes on by 4 ms with each tick; 33 ms between two of them."""
    times = iter(0.004 * (n // 2 + n % 2) for n in range(10_000))
    monkeypatch.setattr("time.thread_time", lambda: next(times))
    load = composition.core_load("gait_alone", "walk")
    assert load == pytest.approx(0.004 / 0.033, rel=0.02)


NODES = {
    name: content.get("ros__parameters") or content[name]["ros__parameters"]
    for name, content in yaml.safe_load(
        (SHARE / "nav2/nav2_params.yaml").read_text()
    ).items()
}
FOLLOW, BEHAVIOR = (
    NODES["controller_server"]["FollowPath"],
    NODES["behavior_server"],
)


@pytest.mark.parametrize(
    "velocity",
    [
        [FOLLOW["desired_linear_vel"], 0.0, 0.0],
        [FOLLOW["regulated_linear_scaling_min_speed"], 0.0, 0.0],
        [0.0, 0.0, FOLLOW["rotate_to_heading_angular_vel"]],
        [0.0, 0.0, BEHAVIOR["max_rotational_vel"]],
        [0.0, 0.0, BEHAVIOR["min_rotational_vel"]],
    ],
)
def test_the_gait_reaches_every_speed(velocity):
    assert read_gaits().clipped("walk", velocity)[1] == ""


def test_acceleration_and_progress_are_those_of_the_robot():
    turns = FOLLOW["max_angular_accel"], BEHAVIOR["rotational_acc_lim"]
    assert max(turns) <= read_gaits().turn_acceleration
    progress = NODES["controller_server"]["progress_checker"]
    slowest = (
        progress["required_movement_radius"]
        / progress["movement_time_allowance"]
    )
    assert slowest < 0.5 * FOLLOW["regulated_linear_scaling_min_speed"]


@pytest.mark.parametrize("costmap", ["local_costmap", "global_costmap"])
def test_the_footprint_holds_the_feet_of_straight_legs(costmap):
    corners = np.array(json.loads(NODES[costmap]["footprint"]))
    robot = read_robot()
    tips = robot.clamps[:, :2] + robot.leg.reach * robot.outward[:, :2]
    assert (np.abs(tips) < corners.max(axis=0)).all()


PACKAGES = (
    SHARE.parent / "src" / "slot_core",
    SHARE.parent / "src" / "slot_nodes",
    SHARE,
)


def test_a_program_under_another_python_finds_them_behind_its_own_packages():
    """As `ros2 launch`, in a terminal in which scripts/env was sourced."""
    done = subprocess.run(
        [
            sys.executable,
            "-S",
            "-c",
            "import slot_bringup, sys; print(*sys.path, sep='\\n')",
        ],
        env={
            "PYTHONPATH": os.pathsep.join(map(str, PACKAGES)),
            "VIRTUAL_ENV": sys.prefix,
        },
        capture_output=True,
        text=True,
        check=True,
    )
    *others, last = done.stdout.splitlines()
    assert Path(last).parents[2] == Path(sys.prefix)
    assert last not in others


@pytest.mark.parametrize(
    "module", ["slot_nodes.mpc_controller_node", "slot_bringup.run"]
)
def test_a_program_without_its_libraries_says_in_one_line_what_to_source(
    module,
):
    # -S leaves out the packages installed for this Python
    done = subprocess.run(
        [sys.executable, "-S", "-c", f"import {module}"],
        env={"PYTHONPATH": os.pathsep.join(map(str, PACKAGES))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "scipy" in line
    assert "source scripts/env" in line
