"""Command line of scripts/run."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
from nav_msgs.msg import Odometry
from synthetic_walk import Walk, write_walk

from slot_bringup import live_page, monitor, run
from slot_bringup.arguments import parse
from slot_msgs.msg import MpcState, TendonPlan
from slot_nodes import qos
from slot_nodes.messages import header

PATH = Path(__file__).resolve().parents[1] / "bags/path.csv"


@pytest.fixture
def refused(refusal):
    """A function that gives arguments to scripts/run, which has to refuse them; its line."""

    def refuse(*arguments):
        line = refusal(lambda given: run.check_options(parse(given)), *arguments)
        assert line.startswith("scripts/run: ")
        return line

    return refuse


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--vx 3", "v_x = 3: gait walk reaches [-0.0"),
        ("--vx fast", "argument --vx: invalid float value: 'fast'"),
        ("--gait trot", "no gait 'trot' (known: "),
        ("--scene moon", "scene/moon"),
        ("--duration -1", "argument --duration: -1 s: outside [0.5, 86400] s"),
        ("--hardware wheels", "argument --hardware: invalid choice: 'wheels'"),
        ("--seed 1.5", "argument --seed: invalid int value: '1.5'"),
        ("--bag x --no-bag", "not allowed with argument"),
        ("--bag .", "bag .: exists already"),
        ("--seed -1", "seed = -1: outside [0, 9223372036854775807]"),
        (
            "--lockstep --attended",
            "lockstep: an operator and the e-stop's source live in real",
        ),
        (
            "--lockstep --hardware real",
            "lockstep: servos of hardware real move in real time",
        ),
        (
            "--lockstep --hardware fake_bus --port /tmp/x",
            "port: emulated servos have none in lock",
        ),
        (f"--gait sit --path {PATH}", "path: gait sit with this velocity stays in its"),
        ("--namespace a$b", "namespace = 'a$b': Invalid namespace: "),
        (
            "--frame-prefix /a/",
            "frame_prefix = '/a/': tf2 knows no frames that begin with",
        ),
        (
            "--frame-prefix fred",
            "frame_prefix = 'fred': expected one that ends with a slash, fred/",
        ),
        (
            "--hardware fake_bus --port /nowhere/x",
            "port /nowhere/x: not in an existing directory",
        ),
        (
            "--path /dev/zero",
            "/dev/zero: no path with columns x, y: not a regular file",
        ),
        ("--calibration /dev/zero", "calibration /dev/zero: not a regular file"),
        ("--policy /dev/zero.py", "policy /dev/zero.py: FileNotFoundError"),
        ("--view", "viser is missing; run scripts/setup --play"),
    ],
)
def test_a_wrong_value_is_refused_with_one_line(
    refused, monkeypatch, arguments, message
):
    monkeypatch.setattr(live_page.importlib.util, "find_spec", {}.get)  # without viser
    assert message in refused(*arguments.split())


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


def test_a_run_whose_summary_cannot_be_printed_fails(monkeypatch, capsys):
    """A full disk behind the output: the run itself went well."""

    def made(options, graph, directory, remarks):
        return write_walk(directory, Walk(truth=False))

    monkeypatch.setattr(run, "run", made)
    assert run.main(["--no-bag"]) == 0
    capsys.readouterr()
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr("sys.stdout", full)
        assert run.main(["--no-bag"]) == 1
    assert "scripts/run: output: No space left on device\n" in capsys.readouterr().err


@pytest.mark.parametrize(("missing", "code"), [((), 0), (("recorder",), 1)])
def test_a_run_that_ended_without_its_recorder_fails_and_says_so(
    monkeypatch, capsys, missing, code
):
    """Though the robot walked on."""
    said = [f"{name} ended; the robot goes on without it" for name in missing]

    def started(graph, values, logs):
        write_walk(logs.parent, Walk(truth=False))
        return nullcontext(SimpleNamespace(remarks=said, missing={*missing}))

    monkeypatch.setattr(run, "started", started)
    monkeypatch.setattr(run, "watch", lambda *_, **__: None)
    assert run.main(["--no-bag"]) == code
    assert [
        line for line in capsys.readouterr().out.splitlines() if "ended;" in line
    ] == said


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
    progress, stamp, count = monitor.Progress(supervised=False), 1000.0, 0.0

    def walk(seconds, share=1.0, skipped=0.0):
        nonlocal stamp, count
        for _ in range(round(seconds / PERIOD)):
            now[0], stamp, count = (
                now[0] + PERIOD,
                stamp + share * PERIOD,
                count + skipped * PERIOD,
            )
            message = Odometry(header=header(round(stamp * 1e9)))
            progress.update_truth(message)
            progress.update_plan(TendonPlan(skipped=int(count)))
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


def test_a_run_hears_its_pace_and_says_it_before_it_fails(monkeypatch, capsys):
    """A simulation at half of real time, of which a node ends after 3 s."""
    now, heard = [100.0], {}

    def sleep(seconds):
        now[0] += seconds

    def spin_once(_):
        heard["ground_truth/odom"](Odometry(header=header(round(0.5e9 * now[0]))))

    class Ending(dict):
        """Processes without a supervisor."""

        def failed(self):
            return ("mpc_controller", 1) if now[0] > 103.0 else None

        def last_line(self, name):
            return "its last words"

        def restart_ended(self, time):
            return []

    def hear(kind, topic, callback, profile):
        heard[topic] = callback

    made = (
        SimpleNamespace(create_subscription=hear),
        SimpleNamespace(spin_once=spin_once),
    )
    monkeypatch.setattr(monitor, "listener", lambda *_: nullcontext(made))
    clock = SimpleNamespace(monotonic=lambda: now[0], sleep=sleep)
    monkeypatch.setattr(monitor, "time", clock)
    with pytest.raises(
        monitor.RunError, match="mpc_controller ended with exit code 1: its last"
    ):
        monitor.watch(Ending(), 60.0, remedy="use --lockstep")
    said = "slower than real time: the simulation went at 50 % of it; use --lockstep"
    assert capsys.readouterr().err == f"scripts/run: {said}\n"
    assert {"tendon_plan", "mpc_state", "robot_state"} < heard.keys()


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
    options = parse([*arguments.split(), "--no-bag"])
    assert run._remedy(vars(options)) == remedy
