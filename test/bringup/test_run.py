"""Command line of scripts/run."""

import sys
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from nav_msgs.msg import Odometry
from synthetic_walk import Walk, write_walk

from slot_bringup import monitor, run
from slot_bringup.arguments import parse
from slot_msgs.msg import MpcState, TendonPlan
from slot_nodes import qos
from slot_nodes.messages import header

PATH = Path(__file__).resolve().parents[1] / "bags/path.csv"


@pytest.fixture
def refused(refusal):
    """A function that gives arguments to scripts/run, which has to refuse them; its line."""
    return partial(refusal, lambda words: run.check_options(parse(words)))


@pytest.mark.parametrize("domain", ["abc", "-1", "233"])
def test_an_invalid_ros_domain_is_refused(refused, monkeypatch, domain):
    """Fast DDS would abort the process, and the nodes would keep running."""
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    assert f"ROS_DOMAIN_ID = '{domain}': expected a number within [0, 232]" in refused()


def test_keys_of_sros2_that_are_not_there_are_refused(refused, monkeypatch, tmp_path):
    """ROS itself ends in a traceback; scripts/env keeps these variables with SLOT_NETWORK=1."""
    for name, value in {
        "ENABLE": "true",
        "STRATEGY": "Enforce",
        "KEYSTORE": tmp_path,
    }.items():
        monkeypatch.setenv(f"ROS_SECURITY_{name}", str(value))
    assert f"ROS_SECURITY_KEYSTORE = '{tmp_path}'" in refused()


def test_a_scene_with_a_servo_fault_is_refused_without_a_servo_bus(own_config, refused):
    fault = "{kind: silent, leg: FL, time: 1, duration: 0, value: 0}"
    (own_config / "scene" / "mute.yaml").write_text(
        f"like: flat\nfaults: {{fl: {fault}}}\n"
    )
    message = "fault 'silent': only the servos of hardware fake_bus can have it"
    assert refused("--scene", "mute") == f"scripts/run: {message}"
    assert (
        run.check_options(parse(["--scene", "mute", "--hardware", "fake_bus"])) is None
    )


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
        write_walk(logs.parent, Walk(truth=False))
        return nullcontext(SimpleNamespace(remarks=said, missing={*missing}))

    monkeypatch.setattr(run, "started", started)
    monkeypatch.setattr(run, "watch", lambda *_, **__: None)
    with Path(output).open("w") if output else nullcontext(sys.stdout) as stream:
        monkeypatch.setattr("sys.stdout", stream)
        assert run.main(["--no-bag"]) == code
    shown = capsys.readouterr()
    assert [line for line in shown.out.splitlines() if "ended;" in line] == said
    assert ("output: No space left on device" in shown.err) == bool(output)


@pytest.mark.parametrize("began", [True, False])
def test_a_run_that_never_stood_or_never_began_says_just_that(
    monkeypatch, capsys, began
):
    """An operator who has asked for nothing; another graph in the domain."""

    def made(options, graph, directory, remarks):
        if not began:
            raise monitor.RunError("another graph runs")
        write_walk(directory, Walk(duration=0.0, truth=False, lost=(0,)))
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "run", made)
    run.main(["--attended", "--no-bag"])
    said = capsys.readouterr().err.splitlines()
    if began:
        assert said[0] == "scripts/run: interrupted, all nodes stopped"
        assert "no summary: the robot never stood" in said[1]
        assert "scripts/operate: r ready, s stand, w walk" in said[1]
    else:
        assert said == ["scripts/run: another graph runs"]


def test_a_run_without_simulated_legs_is_reported_without_their_plot(tmp_path, capsys):
    bag = write_walk(tmp_path / "walk", Walk(truth=False))
    run.report(bag, keep=True)
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == f"bag, summary.txt, walk.png and log/ are in {bag}"
    assert not (bag / "robot.png").exists()


def test_a_state_does_not_wait_behind_older_ones_where_the_machine_is_busy():
    """Else a graph in real time looks slow, once more of them come than are looked at."""
    with monitor.listener("state_estimator", "busy") as (node, executor):
        progress = monitor.Progress(supervised=False)
        progress.listen(node, pace=True)
        publish = node.create_publisher(MpcState, "mpc_state", qos.CONTROL).publish
        for second in range(20):
            publish(MpcState(header=header(second * 10**9)))
        assert executor.spin_until(lambda: progress.state is not None, 60.0)
        assert progress.stamp == 19.0


PERIOD = 1 / 30  # s, of the odometry


@pytest.fixture
def passed(monkeypatch):
    """A function that lets seconds pass in a walk; the progress, as of a graph at a share of time.

    skipped: states a second that the MPC leaves out.
    """
    now = [100.0]  # s, monotonic
    monkeypatch.setattr(monitor.time, "monotonic", lambda: now[0])
    progress = monitor.Progress(supervised=False)
    reached = {"stamp": 1000.0, "skipped": 0.0}

    def walk(seconds, share=1.0, skipped=0.0):
        for _ in range(round(seconds / PERIOD)):
            now[0] += PERIOD
            reached["stamp"] += share * PERIOD
            reached["skipped"] += skipped * PERIOD
            stamp = header(round(reached["stamp"] * 1e9))
            progress.update_truth(Odometry(header=stamp))
            progress.update_plan(TendonPlan(skipped=int(reached["skipped"])))
        return progress

    return walk


@pytest.mark.parametrize(
    ("pace", "found"),
    [
        ({}, ""),
        ({"share": 0.6}, "slower than real time: the simulation went at 60 % of it"),
        (
            {"skipped": 9.1},
            "slower than real time: mpc_controller skipped 9 states a second",
        ),
    ],
)
def test_a_graph_slower_than_real_time_says_so_with_its_share(passed, pace, found):
    assert passed(3.0).slowness() == ""
    assert passed(1.5, **pace).slowness() == found


def test_the_pace_is_said_with_the_remedy_before_the_supervisors_own_line(
    passed, capsys
):
    report = monitor.PaceReport(passed(1.5, share=0.5), "use --lockstep")
    line = "scripts/run: slower than real time: the simulation went at 50 % of it; use --lockstep\n"
    report.print(urgent=False)
    report.print(urgent=False)
    assert capsys.readouterr().err == line  # once
    report.print(urgent=True)  # the robot goes slack
    assert capsys.readouterr().err == line


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        ("", "use --lockstep, or run fewer processes (--composed)"),
        ("--composed", "use --lockstep, or run fewer processes"),
        ("--hardware real", "run fewer processes (--composed)"),
        ("--lockstep", ""),
        ("--hardware none", ""),
    ],
)
def test_the_remedy_fits_the_run(arguments, remedy):
    assert run._remedy(vars(parse(arguments.split()))) == remedy
