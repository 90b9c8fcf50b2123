"""Command line of scripts/run.

End of the graph's processes.

The recorder as a process: nothing is lost at its end, and little when it is killed.
"""

import re
import signal
import subprocess
import sys
import time
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from real_graph import nodes_of, set_values

from slot_bringup import monitor, processes, run
from slot_bringup.arguments import parse
from slot_bringup.graph import END, GO_ON, REFUSED, RESTART, NodeSpec
from slot_bringup.monitor import listener
from slot_bringup.processes import command_line
from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.record_settings import BagError, read_record_settings
from slot_core.safety.states import RELEASED
from slot_lab.bags.bag import Bag
from slot_msgs.msg import MpcState, RobotState, TendonPlan
from slot_nodes import qos
from slot_nodes.messages import header

DOMAIN = "ROS_DOMAIN_ID"
EXAMPLE = Path(__file__).parents[2] / "slot_bringup" / "example" / "walk"


@pytest.fixture
def refused(refusal):
    """A function that gives arguments to scripts/run, which has to refuse them; its line."""
    return partial(refusal, lambda words: run.check_options(parse(words)))


@pytest.mark.parametrize(
    ("variables", "line"),
    [
        (
            {DOMAIN: "abc"},
            f"{DOMAIN} = 'abc': expected a number within [0, 232]",
        ),
        ({DOMAIN: "-1"}, f"{DOMAIN} = '-1': expected a number within [0, 232]"),
        (
            {DOMAIN: "233"},
            f"{DOMAIN} = '233': expected a number within [0, 232]",
        ),
        (
            {
                "ROS_SECURITY_ENABLE": "true",
                "ROS_SECURITY_STRATEGY": "Enforce",
                "ROS_SECURITY_KEYSTORE": "/nowhere",
            },
            "ROS_SECURITY_KEYSTORE = '/nowhere'",
        ),
    ],
)
def test_an_environment_that_ros_cannot_use_is_refused(
    refused, monkeypatch, variables, line
):
    """Fast DDS would abort the process and leave the nodes; sros2 ends in a traceback."""
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert line in refused()


def test_a_scene_with_a_servo_fault_is_refused_without_a_servo_bus(
    own_config, refused
):
    fault = "{kind: silent, leg: FL, time: 1, duration: 0, value: 0}"
    scene = own_config / "scene" / "mute.yaml"
    scene.write_text(f"like: flat\nfaults: {{fl: {fault}}}\n")
    message = "fault 'silent': only the servos of hardware fake_bus can have it"
    assert refused("--scene", "mute") == f"scripts/run: {message}"
    run.check_options(parse(["--scene", "mute", "--hardware", "fake_bus"]))


def test_a_run_refuses_the_leg_map_of_another_leg_and_warns_of_its_gait(
    own_config, refused, capsys
):
    """Files that name no leg are taken, and that is said."""
    azimuth = [60.0, -60.0, 120.0, -120.0]
    set_values(own_config, {"robot": {"leg.azimuth_deg": azimuth}})
    run.check_options(parse([]))
    assert capsys.readouterr().err == (
        "scripts/run: gait/walk.yaml was made for leg.azimuth_deg = 45 -45 135 -135 deg,"
        " robot.yaml says 60 -60 120 -120 deg; scripts/tune leg makes it anew\n"
    )
    set_values(own_config, {"robot": {"leg.reach": 0.15}})
    assert "leg_map.csv was made for leg.reach = 0.19 m, rob" in refused()
    for file in ("leg_map.csv", "gait/walk.yaml"):
        text = (own_config / file).read_text()
        (own_config / file).write_text(
            re.sub(
                r"^# made_for.*\n|^made_for:\n(  .*\n)*", "", text, flags=re.M
            )
        )
    run.check_options(parse([]))
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2
    assert all("does not say for which leg it was made; s" in x for x in said)


@pytest.mark.parametrize(
    ("missing", "output", "code"),
    [((), "", 0), (("recorder",), "", 1), ((), "/dev/full", 1)],
)
def test_a_run_fails_without_its_recorder_or_where_its_summary_cannot_be_printed(
    monkeypatch, capsys, missing, output, code
):
    """Though the robot walked on; a full disk is behind the output."""
    said = [f"{name} ended; the robot goes on without it" for name in missing]

    def started(graph, values, logs):
        Bag(EXAMPLE).save(logs.parent)
        return nullcontext(SimpleNamespace(remarks=said, missing={*missing}))

    monkeypatch.setattr(run, "started", started)
    monkeypatch.setattr(run, "watch", lambda *_, **__: None)
    with (
        Path(output).open("w") if output else nullcontext(sys.stdout) as stream
    ):
        monkeypatch.setattr("sys.stdout", stream)
        assert run.main(["--no-bag"]) == code
    shown = capsys.readouterr()
    assert [line for line in shown.out.splitlines() if "ended;" in line] == said
    assert ("output: No space left on device" in shown.err) == bool(output)


def test_a_run_that_never_stood_says_just_that(monkeypatch, capsys):
    """An operator who has asked for nothing."""

    def made(options, graph, directory, remarks):
        BagWriter(directory, read_record_settings()).close()
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "run", made)
    run.main(["--attended", "--no-bag"])
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "scripts/run: interrupted, all nodes stopped"
    assert "no summary: the robot never stood" in said[1]
    assert "scripts/operate: r ready, s stand, w walk" in said[1]


def test_a_state_does_not_wait_behind_older_ones_where_the_machine_is_busy():
    """Else a graph in real time looks slow, once more of them come than are looked at."""
    with monitor.listener("state_estimator", "busy") as (node, executor):
        progress = monitor.Progress(supervised=False)
        progress.listen(node, pace=True)
        publish = node.create_publisher(
            MpcState, "mpc_state", qos.CONTROL
        ).publish
        for second in range(20):
            publish(MpcState(header=header(second * 10**9)))
        assert executor.spin_until(lambda: progress.state is not None, 60.0)
        assert progress.stamp == 19.0


def test_a_warning_of_the_walk_is_told_once_whatever_its_numbers():
    progress, say = monitor.Progress(supervised=True), "slides {} mm/s right"
    for speed in (20, 21, 22):
        warnings = [say.format(speed)]
        for state in (RobotState.STANDING, RobotState.WALKING):
            progress.update_robot(RobotState(state=state, warnings=warnings))
    assert progress.news == ["slides 20 mm/s right"]


@pytest.mark.parametrize("attended", [False, True])
@pytest.mark.parametrize("state", RELEASED)
def test_a_robot_that_goes_slack_ends_a_run_without_an_operator_in_one_line(
    state, attended
):
    progress = monitor.Progress(supervised=True)
    reason = "roll +0.510 rad, limit 0.5 rad"
    progress.update_robot(RobotState(state=state.value, reason=reason))
    processes, line = Mock(), f"the robot is in {state.name}: {reason}"
    processes.failed.return_value = None
    with (
        nullcontext()
        if attended
        else pytest.raises(monitor.RunError, match=re.escape(line))
    ):
        monitor._check(progress, processes, attended)


@pytest.mark.parametrize(
    ("share", "skipped", "found"),
    [
        (1.0, 0.0, ""),
        (0.6, 0.0, "slower than real time: the simulation went at 60 % of it"),
        (
            1.0,
            9.1,
            "slower than real time: mpc_controller skipped 9 states a second",
        ),
    ],
)
def test_a_graph_slower_than_real_time_says_so_with_its_share(
    monkeypatch, share, skipped, found
):
    """share: of real time; skipped: states a second that the MPC leaves out."""
    progress = monitor.Progress(supervised=False)
    for passed in np.arange(0.0, 1.5, 1 / 30):
        monkeypatch.setattr("time.monotonic", lambda: 100.0 + passed)  # noqa: B023
        stamp = header(round((1000.0 + share * passed) * 1e9))
        progress.update_truth(Odometry(header=stamp))
        progress.update_plan(TendonPlan(skipped=int(skipped * passed)))
    assert progress.slowness() == found


@pytest.fixture
def start(tmp_path, monkeypatch):
    """A function that starts a shell script as a node."""

    def start(script, if_it_ends=END):
        words = ["/bin/bash", "-c", script]
        monkeypatch.setattr(processes, "command_line", lambda _: words)
        started = processes.Processes(tmp_path)
        spec = NodeSpec(
            "viewer", "of_no_python_package", {}, if_it_ends=if_it_ends
        )
        started.start([spec])
        return started

    return start


@pytest.mark.parametrize(
    "end",
    [
        ("", -9, "did not end within 0.2 s of SIGINT: killed"),
        ("exit 3", 3, "ended with exit code 3: its last words"),
    ],
)
def test_a_node_that_is_killed_or_fails_at_its_end_is_named(
    start, monkeypatch, capsys, end
):
    trap, code, line = end
    if not trap:
        monkeypatch.setattr(processes, "STOP_TIMEOUT", 0.2)
    loop = "while :; do sleep 0.01; done"
    started = start(f"trap '{trap}' INT; echo its last words; echo; {loop}")
    while started.last_line("viewer") != "its last words":
        time.sleep(0.01)
    assert started.stop() == {"viewer": code}
    assert capsys.readouterr().err == f"scripts/run: viewer {line}\n"


@pytest.mark.parametrize(
    ("if_it_ends", "code"), [(END, 3), (GO_ON, REFUSED), (RESTART, REFUSED)]
)
def test_a_process_that_is_needed_or_refuses_its_configuration_ends_the_graph(
    start, if_it_ends, code
):
    started = start(f"exit {code}", if_it_ends)
    started._children["viewer"].join()
    assert started.failed() == ("viewer", code)


@pytest.mark.parametrize(
    ("if_it_ends", "restarts"), [(GO_ON, 0), (RESTART, processes.RESTARTS)]
)
def test_a_process_that_is_not_needed_is_restarted_a_few_times_then_missed(
    start, if_it_ends, restarts
):
    started = start("echo its last words; exit 3", if_it_ends)
    line = "at 1.5 s viewer ended with exit code 3: its last words; "
    started._children["viewer"].join()
    for _ in range(restarts):
        assert started.restart_ended(1.5) == [line + "restarted"]
        started._children["viewer"].join()
    assert started.restart_ended(1.5) == [line + "the robot goes on without it"]
    assert started.restart_ended(1.6) == []  # said once
    assert started.failed() is None
    assert started.missing == {"viewer"}
    assert len(started.remarks) == restarts + 1


SET = {"scene": "slope5", "namespace": "recorded"}
LEAST = 50  # messages on disk before the recorder is ended


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_recorder_that_ends_loses_nothing_and_a_killed_one_the_last_moment(
    tmp_path, number
):
    path = tmp_path / "bag"
    recorder = nodes_of(**SET, bag=str(path))["recorder"]
    process = subprocess.Popen(command_line(recorder))
    count, left = 0, []
    with listener("robot", "recorded") as (node, _):
        publisher = node.create_publisher(Odometry, "odom", qos.SENSOR)
        while not publisher.get_subscription_count():
            time.sleep(0.02)
        while len(left) < LEAST:
            publisher.publish(Odometry(child_frame_id=str(count)))
            count += 1
            time.sleep(0.005)
            if count % LEAST == 0:
                with suppress(BagError):
                    left = frames(Bag(path, "recorded"))
        assert publisher.wait_for_all_acked(Duration(seconds=60))
        process.send_signal(number)
        code = process.wait()
    bag, told = Bag(path, "recorded"), number == signal.SIGTERM
    left = frames(bag)
    assert (code, bag.finished) == (0 if told else -number, told)
    assert left == [str(n) for n in range(count if told else len(left))]
    assert len(left) >= LEAST
    about = bag.origin.about
    assert about.pop("revision")
    assert about == {"hardware": "sim", "gait": "walk"} | SET


def frames(bag):
    return [message.child_frame_id for _, message in bag.messages("/odom")]
