"""Graph description, and the launch file that starts it."""

import re
import runpy
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import ament_index_python.packages
import pytest

from slot_bringup.check import check
from slot_bringup.graph import END, GO_ON, REFUSED, RESTART, read_graph
from slot_bringup.processes import command_line
from slot_core.config import ConfigError
from slot_core.recording.record_settings import read_record_settings
from slot_core.safety.settings import read_supervisor

PARAMETERS = Path(__file__).parent / "params.yaml"


@pytest.fixture
def graph():
    return read_graph()


def values(graph, **changes):
    return {a.name: a.default for a in graph.arguments} | changes


def test_the_recorder_runs_only_with_a_bag(graph):
    without = [spec.name for spec in graph.nodes(values(graph))]
    assert "recorder" not in without
    assert [s.name for s in graph.nodes(values(graph, bag="x"))] == [
        "recorder",
        *without,
    ]


def test_arguments_reach_their_nodes_in_the_yaml_that_ros_parses(graph):
    given = values(graph, vx=0.05, vy=0.0, yaw_rate=0.02, seed=3, lockstep=True)
    nodes = {s.name: s for s in graph.nodes(given)}
    arguments = command_line(nodes["supervisor"])
    assert {
        'gait:="walk"',
        "v_x:=0.05",
        "v_y:=0.0",
        "yaw_rate:=0.02",
        "lockstep:=true",
    } <= set(arguments)
    assert "seed:=3" in command_line(nodes["sim_robot"])
    assert not any("gait:=" in word for word in command_line(nodes["gait_scheduler"]))
    assert all("use_sim_time:=true" in command_line(spec) for spec in nodes.values())


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
    """In lockstep robot and supervisor too; the driver, whose watchdog outlives them, never."""
    given = {
        "hardware": hardware,
        "lockstep": lockstep,
        "vx": 0.05,
        "policy": "paper_text",
    }
    chosen = values(graph, bag="x", **given)
    separate = {s.name: s for s in graph.nodes(chosen)}
    *others, process = graph.nodes(chosen | {"composed": True})
    shared = ["state_estimator", "gait_scheduler", "mpc_controller", "force_mapper"]
    shared += ["sim_robot", "supervisor"] if lockstep else []
    assert sorted(process.nodes) == sorted(shared)
    assert [s.name for s in others] == [
        name for name in separate if name not in process.nodes
    ]
    for name in process.nodes:
        assert separate[name].parameters.items() <= process.parameters.items()
    line = command_line(process)
    assert line[1 : 1 + len(process.nodes)] == list(process.nodes)
    assert not any(word.startswith("__node") for word in line)  # they keep their names


def test_what_the_walk_waits_for_gets_the_real_time_priority_and_no_more(graph):
    chosen = values(graph, hardware="fake_bus", realtime=50, bag="x", visualize=True)
    specs = graph.nodes(chosen)
    first = {spec.name for spec in specs if spec.environment == {"SLOT_PRIORITY": "50"}}
    [process] = [
        s
        for s in graph.nodes(values(graph, hardware="fake_bus", composed=True))
        if s.nodes
    ]
    assert first == {*process.nodes, "dynamixel_driver", "supervisor", "sim_robot"}
    with pytest.raises(ConfigError, match=r"realtime = 100: outside \[0, 99\]"):
        check(values(graph, realtime=100))


def test_driver_and_emulated_servos_share_one_port(graph):
    nodes = {s.name: s for s in graph.nodes(values(graph, hardware="fake_bus"))}
    port = nodes["dynamixel_driver"].parameters["bus.port"]
    assert port
    assert nodes["sim_robot"].parameters["bus"] == port


def test_real_servos_differ_from_emulated_ones_in_port_sensors_and_needing_an_operator(
    graph,
):
    specs = graph.nodes(values(graph, hardware="real", port="/dev/ttyUSB7"))
    real = {s.name: s for s in specs}
    assert "sim_robot" not in real
    emulated = {s.name: s for s in graph.nodes(values(graph, hardware="fake_bus"))}
    for name, spec in real.items():
        changes = {
            "dynamixel_driver": {"bus.port": "/dev/ttyUSB7"},
            "supervisor": {"autostart": False},
        }.get(name, {})
        expected = emulated[name].parameters | changes
        assert (
            expected.pop("estop_required", False) is False
        )  # config/supervisor.yaml has true
        if "best_effort_sensors" in expected:  # as cameras publish
            expected["best_effort_sensors"] = True
        assert spec.parameters == expected


def test_a_scene_with_a_camera_starts_the_localiser_and_says_what_carries_the_camera(
    graph,
):
    assert "marker_localizer" not in {s.name for s in graph.nodes(values(graph))}
    nodes = {s.name: s for s in graph.nodes(values(graph, scene="marker_camera"))}
    assert nodes["marker_localizer"].parameters["carrier"] == "torso"
    real = {
        s.name: s for s in graph.nodes(values(graph, hardware="real", markers=True))
    }
    assert "carrier" not in real["marker_localizer"].parameters  # that of vision.yaml


def test_odometry_of_another_topic_is_remapped_in_every_node(graph):
    topic = "/visual_slam/tracking/odometry"
    for spec in graph.nodes(values(graph, odometry_topic=topic)):
        assert f"odom:={topic}" in command_line(spec)
        assert not any(text.startswith("imu:=") for text in command_line(spec))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"markers": True}, "markers: the scene flat has no camera"),
        ({"calibration": "nowhere.yaml"}, r"calibration nowhere\.yaml: No such file"),
        ({"odometry_topic": "a b"}, r"odometry_topic = 'a b': Invalid topic name"),
        ({"imu_topic": ""}, r"imu_topic = '': Invalid topic name"),
    ],
)
def test_arguments_of_the_camera_and_topics_are_checked(graph, changes, reason):
    with pytest.raises(ConfigError, match=reason):
        check(values(graph, **changes))


def test_velocities_without_a_stamp_reach_scheduler_and_recorder(graph):
    nodes = {
        s.name: s for s in graph.nodes(values(graph, bag="x", stamped_cmd_vel=False))
    }
    for name in ("gait_scheduler", "recorder"):
        assert "stamped_cmd_vel:=false" in command_line(nodes[name])


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
            "mpc_controller: {ros__parameters: {cots: 1}}",
            "/mpc_controller: cots is not a setting",
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


@pytest.mark.parametrize("hardware", ["sim", "fake_bus"])
def test_an_attended_simulation_waits_for_an_operator_like_the_real_robot(
    graph, hardware
):
    real = {s.name: s for s in graph.nodes(values(graph, hardware="real"))}
    attended = {
        s.name: s for s in graph.nodes(values(graph, hardware=hardware, attended=True))
    }
    assert attended["supervisor"].parameters == real["supervisor"].parameters


@pytest.mark.parametrize("namespace", ["fred", "/fred"])
def test_a_node_gets_its_namespace_with_a_leading_slash(graph, namespace):
    for spec in graph.nodes(values(graph, namespace=namespace, frame_prefix="fred/")):
        arguments = command_line(spec)
        assert "__ns:=/fred" in arguments
        assert "/clock:=clock" in arguments
        assert 'frame_prefix:="fred/"' in arguments


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("vx", "fast", "a number"),
        ("seed", "1.5", "a whole number"),
        ("lockstep", "perhaps", "true or false"),
        ("seed", "", "a whole number"),
    ],
)
def test_a_launch_argument_of_the_wrong_type_is_refused_by_name(
    graph, name, text, expected
):
    argument = next(a for a in graph.arguments if a.name == name)
    with pytest.raises(ValueError, match=f"^{name} = '{text}': expected {expected}$"):
        argument.parse(text)


def test_the_launch_file_starts_the_nodes_of_the_description(graph, monkeypatch):
    """Against stubs of launch and launch_ros, which are not among the Python wheels."""
    given = {"bag": "somewhere", "gait": "stand", "vx": "0.0", "namespace": "fred"}
    given |= {"params_file": str(PARAMETERS), "realtime": "0"}
    asked = []
    started = load_launch_file(monkeypatch, given, asked)
    assert asked == ["fred"]
    described = graph.nodes(
        values(graph, **given | {"vx": 0.0, "realtime": 0, "composed": False})
    )
    assert [node["name"] for node in started] == [spec.name for spec in described]
    for node, spec in zip(started, described):
        typed = {
            name: {"args": (value,), "value_type": str}
            if isinstance(value, str)
            else value
            for name, value in spec.parameters.items()
        }
        # launch would read a text such as 1e3 as a number
        assert node["parameters"] == [str(PARAMETERS), typed]
        assert (node["package"], node["executable"]) == (spec.package, spec.name)
        assert (node["namespace"], node["remappings"]) == (
            "fred",
            [("/clock", "clock")],
        )
        assert node["name"] == node["exec_name"] == spec.name
        assert node["prefix"] == "setpriv --pdeathsig TERM"


def test_the_launch_file_chooses_the_processes_of_the_controller_and_says_why(
    monkeypatch,
):
    choice = (True, "controller in one process: it is small")
    monkeypatch.setattr("slot_bringup.composition.choose", lambda _: choice)
    said, *nodes = load_launch_file(monkeypatch, {"composed": ""})
    assert said["msg"] == choice[1]
    assert nodes[-1]["executable"] == "controller"


def test_the_launch_file_records_the_same_topics_with_ros2_bag(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    given = {
        "bag": "somewhere",
        "recorder": "ros2bag",
        "namespace": "fred",
        "gait": "crawl",
        "odometry_topic": "/rtabmap/odom",
    }
    stock, *nodes = load_launch_file(monkeypatch, given)
    assert "recorder" not in {node["name"] for node in nodes}
    robot = next(node for node in nodes if node["name"] == "sim_robot")
    assert "wait_for_recording" not in robot["parameters"][0]  # of the own recorder
    words = stock["cmd"]
    assert words[:3] == ["setpriv", "--pdeathsig", "TERM"]
    assert words[3:8] == ["ros2", "bag", "record", "--output", "somewhere"]
    topics = [*read_record_settings("fred").topics]
    topics[topics.index("/fred/odom")] = "/rtabmap/odom"
    assert words[words.index("--topics") + 1 :] == topics
    about = words[words.index("--custom-data") + 1 : words.index("--topics")]
    assert about[0].startswith("revision=")
    assert about[1:] == [
        "hardware=sim",
        "gait=crawl",
        "scene=flat",
        "odometry_topic=/rtabmap/odom",
        "composed=False",
        "namespace=fred",
    ]


NOT_NEEDED = {"recorder": GO_ON, "visualizer": RESTART}


def test_the_supervisor_says_the_end_of_every_process_without_which_the_graph_goes_on(
    graph,
):
    specs = graph.nodes(values(graph, bag="somewhere", visualize=True))
    assert {s.name: s.if_it_ends for s in specs if s.if_it_ends != END} == NOT_NEEDED
    of_the_launch_file = {"rosbag2_recorder", "robot_state_publisher"}
    assert {*read_supervisor().companions} == NOT_NEEDED.keys() | of_the_launch_file


@pytest.mark.parametrize(
    "name", ["recorder", "visualizer", "ros2bag", "robot_state_publisher"]
)
def test_a_launch_goes_on_without_a_process_that_it_does_not_need(monkeypatch, name):
    end = graph_launch_file(monkeypatch)[-1]["args"][0]["on_exit"]
    running = SimpleNamespace(is_shutdown=False)
    [said] = end(SimpleNamespace(process_name=f"{name}-1", returncode=-9), running)
    assert said["msg"].startswith(
        f"{name}-1 ended with exit code -9; the robot goes on"
    )
    for needed, code in ((name, REFUSED), ("mpc_controller", -9)):
        with pytest.raises(
            RuntimeError, match=f"{needed}-1 ended with exit code {code}"
        ):
            end(SimpleNamespace(process_name=f"{needed}-1", returncode=code), running)


def test_a_launch_restarts_the_viewer_a_few_times(monkeypatch):
    nodes = load_launch_file(monkeypatch, {"visualize": "true", "bag": "somewhere"})
    restarted = {n["name"]: n["respawn_max_retries"] for n in nodes if n.get("respawn")}
    assert {"visualizer": 3}.items() <= restarted.items()
    assert restarted.keys() <= {"visualizer", "robot_state_publisher"}


def test_without_hardware_a_played_bag_gives_sensors_and_clock(graph):
    nodes = {
        s.name: s for s in graph.nodes(values(graph, hardware="none", bag="somewhere"))
    }
    assert not {"sim_robot", "dynamixel_driver"} & nodes.keys()
    assert {"recorder", "state_estimator", "supervisor"} <= nodes.keys()
    assert all(spec.parameters["use_sim_time"] is True for spec in nodes.values())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"vx": "9"}, "v_x = 9: gait walk reaches"),
        ({"bag": "~"}, "exists already"),
    ],
)
def test_the_launch_file_refuses_what_scripts_run_refuses(monkeypatch, given, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_launch_file(monkeypatch, given)


@pytest.mark.parametrize("installed", [True, False])
def test_the_launch_file_starts_the_urdfs_publisher_where_there_is_one(
    monkeypatch, installed
):
    """Also without `visualize`."""

    def prefix(package):
        if package == "robot_state_publisher" and not installed:
            raise ament_index_python.packages.PackageNotFoundError(package)
        return f"/{package}"

    share = str(Path(__file__).parents[2] / "slot_bringup")
    packages = ament_index_python.packages
    monkeypatch.setattr(packages, "get_package_prefix", prefix)
    monkeypatch.setattr(packages, "get_package_share_directory", lambda package: share)
    given = {"robot_description": "true", "namespace": "fred", "frame_prefix": "fred/"}
    model, *_ = load_launch_file(monkeypatch, given)
    if installed:
        assert (model["package"], model["namespace"]) == (
            "robot_state_publisher",
            "fred",
        )
        (parameters,) = model["parameters"]
        assert parameters["frame_prefix"]["args"] == ("fred/",)
        assert '<robot name="slot">' in parameters["robot_description"]["args"][0]
    else:
        assert "robot_state_publisher is not installed" in model["msg"]


def record(*args, **kwargs):
    """Stub of the classes of launch."""
    return kwargs | {"args": args}


def run_launch_file(monkeypatch, name, **stubs):
    """Run a launch file against stubs of modules, as names of their classes; its actions."""
    for module, members in stubs.items():
        stub = SimpleNamespace(**dict.fromkeys(members.split(), record))
        monkeypatch.setitem(sys.modules, module.replace("__", "."), stub)
    path = Path(__file__).parents[2] / "slot_bringup" / "launch" / f"{name}.launch.py"
    return runpy.run_path(str(path))["generate_launch_description"]()["args"][0]


@pytest.mark.parametrize(
    ("program", "words", "fault"),
    [
        (
            "slot.launch.py",
            ["gaits:=walk"],
            "'gaits' (similar: gait; --show-args lists all)",
        ),
        (
            "d435_rtabmap.launch.py",
            ["imu:=x"],
            "'imu' (similar: none; --show-args lists all)",
        ),
        ("slot.launch.py", ["gait:=walk", "recorder:=slot", "launch-prefix:=gdb"], ""),
        (
            "whole_fleet.launch.py",
            ["robots:=3"],
            "",
        ),  # of a user's own, which includes ours
    ],
)
def test_an_unknown_launch_argument_is_refused(monkeypatch, program, words, fault):
    monkeypatch.setattr(
        sys, "argv", ["ros2", "launch", "slot_bringup", program, *words]
    )
    with pytest.raises(ConfigError, match=re.escape(fault)) if fault else nullcontext():
        load_launch_file(monkeypatch, {}, words=words)


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
    """Against stubs: neither launch nor the packages of the camera are among the wheels.

    The packages are looked up when the launch starts, not when the file is read.
    """
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
    groups = [
        a["args"][0][-1]
        for a in actions
        if isinstance(a["args"], tuple) and a["args"] and isinstance(a["args"][0], list)
    ]
    *others, own = [g["args"][0]["args"][0] for g in groups]
    found = [
        location["args"][0][0]["args"][0] for location in others
    ]  # of FindPackageShare
    assert found == packages
    assert Path(own).name == "slot.launch.py"
    given = {a["args"][0]: a["default_value"] for a in actions if "default_value" in a}
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
    given = {"robot_description": "false", "composed": "false"} | given
    asked = [] if asked is None else asked
    monkeypatch.setattr("slot_bringup.monitor.require_no_other_graph", asked.append)
    *arguments, start, _ = graph_launch_file(monkeypatch)
    texts = {
        argument["args"][0]: argument["default_value"] for argument in arguments
    } | given
    return start["function"](SimpleNamespace(launch_configurations=texts, argv=words))
