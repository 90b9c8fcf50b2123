"""Command line of scripts/run."""

import shutil
from pathlib import Path

import pytest
from synthetic_walk import Walk, write_walk

from slot_bringup import run, view
from slot_bringup.graph import read_graph
from slot_core.config import config_dir

PATH = Path(__file__).resolve().parents[1] / "bags/path.csv"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--vx", "3"], "v_x = 3: gait walk reaches [-0.0"),
        (["--vx", "nan"], "v_x = nan: gait walk reaches [-0.0"),
        (["--vy", "0.1"], "v_y = 0.1: gait walk reaches [-0.0"),
        (["--vx", "fast"], "argument --vx: invalid float value: 'fast'"),
        (["--gait", "trot"], "no gait 'trot' (known: "),
        (["--scene", "moon"], "scene/moon"),
        (["--duration", "-1"], "argument --duration: -1 s: outside [0.5, 86400] s"),
        (["--duration", "nan"], "argument --duration: nan s: outside [0.5, 86400] s"),
        (["--hardware", "wheels"], "argument --hardware: invalid choice: 'wheels'"),
        (["--seed", "1.5"], "argument --seed: invalid int value: '1.5'"),
        (["--bag", "x", "--no-bag"], "not allowed with argument"),
        (["--bag", "."], "bag .: exists already"),
        (["--seed", "-1"], "seed = -1: outside [0, 9223372036854775807]"),
        (["--seed", "99999999999999999999"], "seed = 99999999999999999999: outside [0, "),
        (
            ["--lockstep", "--attended"],
            "lockstep: an operator and the e-stop's source live in real time",
        ),
        (
            ["--lockstep", "--hardware", "real"],
            "lockstep: servos of hardware real move in real time",
        ),
        (
            ["--lockstep", "--hardware", "fake_bus", "--port", "/tmp/x"],
            "port: emulated servos have none in lockstep",
        ),
        (["--gait", "sit", "--path", str(PATH)], "path: gait sit with this velocity stays in its"),
        (["--yaw-rate", "0.1"], "yaw rate = 0.1: with the other velocities gait walk reaches 0.05"),
        (["--namespace", "a b"], "namespace = 'a b': Invalid namespace: "),
        (["--namespace", "//a"], "namespace = '//a': Invalid namespace: "),
        (["--frame-prefix", "/a/"], "frame_prefix = '/a/': tf2 knows no frames that begin with"),
        (["--speed", "1"], "unrecognized arguments: --speed 1"),
        (["--view"], "rerun-sdk is missing; run scripts/setup --view"),
    ],
)
def test_a_wrong_value_is_refused_with_one_line_and_exit_code_2(
    capsys, monkeypatch, arguments, message
):
    monkeypatch.setattr(view.importlib.util, "find_spec", {}.get)  # without rerun
    with pytest.raises(SystemExit) as refusal:
        run.parse(arguments, read_graph())
    assert refusal.value.code == 2
    errors = capsys.readouterr().err
    assert message in errors
    assert errors.startswith("scripts/run: ")
    assert errors.count("\n") == 1


@pytest.mark.parametrize("domain", ["abc", "-1", "233"])
def test_an_invalid_ros_domain_is_refused(monkeypatch, capsys, domain):
    """Fast DDS would abort the process, and the nodes would keep running."""
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with pytest.raises(SystemExit) as refusal:
        run.parse([], read_graph())
    assert refusal.value.code == 2
    assert (
        f"ROS_DOMAIN_ID = '{domain}': expected a number within [0, 232]" in capsys.readouterr().err
    )


def test_help_names_every_option(capsys):
    with pytest.raises(SystemExit) as end:
        run.parse(["--help"], read_graph())
    assert end.value.code == 0
    shown = capsys.readouterr().out
    for option in ("gait", "duration", "vx", "vy", "hardware", "bag", "lockstep", "seed", "no-bag",
                   "scene"):  # fmt: skip
        assert f"--{option}" in shown


def test_a_scene_with_a_servo_fault_is_refused_without_a_servo_bus(tmp_path, monkeypatch, capsys):
    directory = tmp_path / "config"
    shutil.copytree(config_dir(), directory)
    fault = "{kind: silent, leg: FL, time: 1, duration: 0, value: 0}"
    (directory / "scene" / "mute.yaml").write_text(f"like: flat\nfaults: {{fl: {fault}}}\n")
    monkeypatch.setenv("SLOT_CONFIG", str(directory))
    with pytest.raises(SystemExit) as refusal:
        run.parse(["--scene", "mute"], read_graph())
    assert refusal.value.code == 2
    message = "fault 'silent': only the servos of hardware fake_bus can have it"
    assert capsys.readouterr().err == f"scripts/run: {message}\n"
    assert run.parse(["--scene", "mute", "--hardware", "fake_bus"], read_graph()).scene == "mute"


def test_the_gait_stand_needs_no_velocity():
    assert run.parse(["--gait", "stand"], read_graph()).vx is None


def test_by_default_the_simulated_robot_walks_for_20_s_in_real_time():
    options = run.parse([], read_graph())
    assert (options.hardware, options.gait, options.duration) == ("sim", "walk", 20.0)
    assert not options.lockstep


def test_a_run_without_simulated_legs_is_reported_without_their_picture(tmp_path, capsys):
    bag = write_walk(tmp_path / "walk", Walk(truth=False))
    run.report(bag, keep=True)
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == f"bag, summary.txt, walk.png and log/ are in {bag}"
    assert not (bag / "robot.png").exists()
