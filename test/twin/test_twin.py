"""The twin: what was recorded is predicted, and known changes of the robot are found."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.gait.gait import read_gaits
from slot_core.robot import read_parameters, read_robot
from slot_lab.bags.recorded_walk import TendonAngles, TorsoTrack
from slot_lab.bags.topics import COMMANDED, MEASURED
from slot_lab.csv_table import TableError
from slot_lab.twin import twin, twin_command, twin_fit
from slot_lab.twin.prediction import predict, read_parts
from slot_lab.twin.strides import (
    COLUMNS,
    BagRecording,
    angle_period,
    error_growth,
    find_strides,
    read_recorded,
    read_twin,
    stride_errors,
)
from slot_lab.twin.twin_fit import (
    changed,
    changes,
    fit_twin,
    parameter,
    places,
)
from slot_lab.validation import validate
from slot_lab.verdict import EXPLAINED, NOT_EXPLAINED
from slot_lab.workers import serially

SETTINGS = config.replace(read_twin(), {"held_out": 0.5})
PARTS = read_parts("flat")
COARSE = dataclasses.replace(  # of the synthetic recording
    PARTS,
    scene=config.replace(
        PARTS.scene,
        {f"solver.{k}": v for k, v in config.load("solver/coarse").items()},
    ),
)
MODULUS = 0.85 * 2.6e7  # Pa
OTHER = changed(
    COARSE, ["scene.floor.friction", "robot.leg.young_modulus"], [0.3, MODULUS]
)
WALK = Path(__file__).parents[1] / "bags" / "walk"
SECONDS, SPEED = 10.0, 0.021  # s, m/s


def walking_angles():
    """Tendon angles of a slow stride of `fast_walk` after a second at rest, at 100 Hz.

    The spools reach them, and the motion settles on one course from every start.
    """
    stride = read_gaits().find("fast_walk")
    t = np.arange(0.0, SECONDS, 0.01)
    velocity = np.array([SPEED, 0.0, 0.0])
    phase = np.clip(t - 1.0, 0.0, None) / stride.period % 1.0
    angle = stride.stride_table(phase, velocity)[:, :4]
    return TendonAngles(
        MEASURED, t, np.clip(angle, 0.0, PARTS.robot.tendon.angle_max)
    )


def track_of(t, pose, noise=0.0):
    """Motion with poses (n, 6) at times (n,)."""
    position, rpy = np.split(np.asarray(pose), 2, axis=1)
    rng = np.random.default_rng(2)
    position = position + rng.normal(scale=noise, size=position.shape)
    rpy = rpy + rng.normal(scale=2 * noise, size=rpy.shape)
    quaternion = Rotation.from_euler("xyz", rpy).as_quat()
    return TorsoTrack("/odom", t, position, quaternion, np.zeros_like(position))


@pytest.fixture(scope="module")
def recorded():
    """A recorded walk of OTHER that starts somewhere."""
    angles = walking_angles()
    t = np.arange(0.0, SECONDS, 0.033)
    start = track_of(t, np.tile([0.3, -0.2, 0.04, 0.0, 0.0, 0.5], (len(t), 1)))
    blank = BagRecording("walked", angles, start, None)
    moved = predict(blank, OTHER, SETTINGS).pose_at(t[:-1])
    return dataclasses.replace(
        blank, motion=track_of(t[:-1], moved, noise=1e-3)
    )


@pytest.mark.parametrize(
    ("angles", "source"), [("", MEASURED), (COMMANDED, COMMANDED)]
)
def test_a_recorded_walk_is_predicted_from_its_own_angles(angles, source):
    """Measured ones, else the commands through the servo, whose lag of 0.1 s makes 10 mm."""
    recorded = read_recorded(WALK, angles=angles)
    measured = recorded.motion
    found = predict(recorded, PARTS, SETTINGS).pose_at(measured.t)
    assert recorded.angles.source == source
    off = np.linalg.norm(found[:, :3] - measured.position, axis=1)
    # The recording may end before a command.
    inside = measured.t <= (recorded.angles.t[-1] if angles else np.inf)
    assert inside.sum() > 40
    # 2.5 mm at the first jump of the angles, recorded at 100 Hz
    assert off[inside].max() < 3e-3


def test_topics_of_a_bag_are_taken_by_their_new_names(refusal):
    renamed = {"/ground_truth/odom": "/odom"}
    found = read_recorded(WALK, motion="/odom", remap=renamed).motion
    assert found.source == "/odom"
    assert (found.position == read_recorded(WALK).motion.position).all()
    wrong = ["--remap", "/pose:=/odom"]
    assert "no topic /pose" in refusal(twin_command.main, WALK, *wrong)
    assert "no topic /pose" in refusal(validate.main, WALK, WALK, *wrong)
    wrong[0] = "--remap-measured"
    assert "no topic /pose" in refusal(validate.main, WALK, WALK, *wrong)


def write_walk(path, recorded):
    """The recorded walk as a CSV file: angles and poses in rows of their own."""
    angles = [
        (t, *row, *[""] * 6)
        for t, row in zip(recorded.angles.t, recorded.angles.angle)
    ]
    pose = recorded.motion
    poses = [(t, *[""] * 4, *row) for t, row in zip(pose.t, pose.pose)]
    rows = [
        ",".join(map(str, row))
        for row in sorted(angles + poses, key=lambda row: row[0])
    ]
    path.write_text("\n".join(["# a walk", ",".join(COLUMNS), *rows]) + "\n")
    return path


def test_a_csv_file_is_the_walk_that_it_holds_and_is_compared(
    recorded, tmp_path, capsys
):
    walk = write_walk(tmp_path / "walk.csv", recorded)
    found, commands = read_recorded(walk), read_recorded(walk, angles=COMMANDED)
    assert (found.angles.measured, commands.angles.measured) == (True, False)
    assert found.angles.angle == pytest.approx(recorded.angles.angle)
    assert found.motion.pose == pytest.approx(recorded.motion.pose)
    with pytest.raises(
        config.ConfigError, match="--motion and --remap are of bags"
    ):
        read_recorded(walk, motion="/odom")
    out = ["--out", str(tmp_path / "out")]
    assert twin_command.main([str(walk), *out]) == NOT_EXPLAINED
    text = capsys.readouterr().out
    assert text.splitlines()[-1].startswith(
        "verdict: not explained: chi-square"
    )
    assert "tendon angles       FL, FR, RL, RR (measured)" in text
    assert (tmp_path / "out" / "twin.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        (
            ["time,x,y,z"],
            "line 1: columns time,x,y,z: expected time,FL,FR,RL,RR,x,y,z,roll",
        ),
        ([",".join(COLUMNS)], "0 rows with FL, FR, RL, RR, less than 2"),
        (
            [",".join(COLUMNS), "0,1,1,1,,,,,,,"],
            "line 2, RR: '' is not a finite number",
        ),
        (
            [",".join(COLUMNS), *["0,1,1,1,1,,,,,,"] * 2],
            "line 3, time: does not increase",
        ),
        (
            [
                ",".join(COLUMNS),
                "0,1,1,1,1,,,,,,",
                "0.1,1,1,1,1,0,0,0,0,0,0",
                "0.2,,,,,0,0,0,0,0,0",
            ],
            "FL, FR, RL, RR and x .. yaw do not overlap",
        ),
    ],
)
def test_a_csv_file_that_holds_no_walk_is_refused(tmp_path, lines, reason):
    (tmp_path / "walk.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises((TableError, config.ConfigError)) as refusal:
        read_recorded(tmp_path / "walk.csv")
    assert reason in str(refusal.value)


@pytest.fixture
def strides(recorded):
    """Of the recorded walk: they begin with its motion and have the period of its angles."""
    found = find_strides(recorded, SETTINGS)
    period = read_gaits().find("fast_walk").period
    assert found.period == pytest.approx(period, abs=0.01)
    assert found.edges[0] == pytest.approx(
        1.0 + SETTINGS.run_in * period, abs=0.1
    )
    return found


def test_standing_before_and_after_the_walk_is_no_stride(recorded):
    """A robot that is attended stands up, waits, walks and stands again."""
    walk = recorded.angles.angle
    waits, stands = np.tile(walk[0], (1500, 1)), np.tile(walk[-1], (3000, 1))
    whole = np.vstack([np.full((200, 4), 0.5), waits, walk, stands])
    t = 0.01 * np.arange(len(whole))
    angles = TendonAngles(MEASURED, t, whole)
    long = BagRecording("long", angles, track_of(t, np.zeros((len(t), 6))), 0.7)
    strides = find_strides(long, SETTINGS)
    # The walk lasts from 18 s, after a second at rest, to 27 s.
    assert (
        18.0 + 0.7 * (SETTINGS.run_in - 1) <= strides.edges[0] <= 18.0 + 3 * 0.7
    )
    assert strides.edges[-1] == pytest.approx(17.0 + SECONDS, abs=0.7)


def test_angles_that_are_no_walk_and_fits_that_it_cannot_tell_are_refused(
    recorded, strides
):
    angles = recorded.angles
    rising = np.tile(angles.t[:, None] / 20, (1, 4))
    odd = dataclasses.replace(
        recorded, angles=TendonAngles(MEASURED, angles.t, rising)
    )
    with pytest.raises(
        config.ConfigError, match="not periodic; name a length with --period"
    ):
        angle_period(odd)
    degrees = dataclasses.replace(angles, angle=np.degrees(angles.angle))
    with pytest.raises(
        config.ConfigError, match=r"angles of .* rad, outside \[0, 2.029\]"
    ):
        predict(dataclasses.replace(recorded, angles=degrees), PARTS, SETTINGS)
    for names, reason in (
        (["lag"], "needs its commands: --angles /desired_joint_angles"),
        (
            ["friction", "young_modulus", "tendon_offset"],
            "5 windows .* 6 parameters",
        ),
    ):
        with pytest.raises(config.ConfigError, match=reason):
            fit_twin(recorded, PARTS, places(names), strides, SETTINGS)


def test_errors_of_strides_are_those_of_the_closed_form(strides):
    t = np.arange(0.0, SECONDS, 0.033)
    slow, fast = (
        track_of(t, np.outer(t, [v, 0.0, 0.0, 0.0, 0.0, 0.0]))
        for v in (0.05, 0.06)
    )
    found = stride_errors(fast, slow, strides).summary()
    assert found["displacement"] == pytest.approx(0.01 * strides.period)
    assert found["place"] == pytest.approx(0.04 * strides.period)
    assert found["turn"] == pytest.approx(0.0)
    growth = error_growth(fast, slow, strides)
    assert growth[:, 1] == pytest.approx(0.01 * strides.period * growth[:, 0])


def test_known_changes_of_the_robot_are_found_and_hold_for_unseen_strides(
    recorded, strides
):
    names = places(["friction", "young_modulus"])
    found = fit_twin(recorded, COARSE, names, strides, SETTINGS)
    friction, modulus = found.estimate.values
    assert friction == pytest.approx(0.3, rel=0.05)
    assert modulus == pytest.approx(MODULUS, rel=0.05)
    before, after = (errors.summary() for errors in found.held_out)
    assert after["place"] < before["place"] / 3
    low, high = found.estimate.interval[0]
    assert low < friction < high
    assert abs(friction - 0.3) < high - low


def test_the_verdict_knows_the_robot_that_walked_from_another(
    recorded, strides
):
    """The noise of the recording is the uncertainty of the settings."""
    measured = recorded.motion
    tracks = [predict(recorded, parts, SETTINGS) for parts in (OTHER, COARSE)]
    same, other = (
        twin.judge(track, measured, strides, SETTINGS) for track in tracks
    )
    assert same.code == EXPLAINED
    assert same.chi_square == pytest.approx(same.freedom, rel=0.1)
    assert other.code == NOT_EXPLAINED


def test_a_change_for_one_leg_leaves_the_others():
    given = changes(PARTS, places(["tendon_offset"])[1:2], [0.0005])
    assert given["scene"] == {"tendons.slack": [0.0, 0.0005, 0.0, 0.0]}
    given = changes(PARTS, ["servo.stall_torque[1]"], [1.3])["servo"]
    assert given["stall_torque"][1] == 1.3


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("colour", "expected one of friction, young_modulus"),
        ("robot.leg.colour", "robot has no number leg.colour"),
        ("robot.torso.mass[1]", "one number, without an index"),
        ("servo.model", "servo has no number model"),
        ("servo.stall_torque", r"expected an index of stall_torque, 0 to 2"),
        ("servo.stall_torque[3]", r"expected an index of stall_torque, 0 to 2"),
    ],
)
def test_a_parameter_that_is_none_is_refused(name, message):
    with pytest.raises(config.ConfigError, match=message):
        parameter(PARTS, places([name])[0])


def test_a_scene_names_a_parameter_set_and_its_own_values_go_before(own_config):
    content = {
        "values": read_parameters("calibrated") | {"leg.young_modulus": 2.0e7},
        "robot": {"torso.mass": 2.2},
        "servo": {"motor_time": 0.02},
        "scene": {
            "floor.friction": [0.3] * 4,
            "tendons.slack": [0, -0.0005, 0, 0],
        },
    }
    twin_fit.write_set("mine", content)
    (own_config / "scene" / "mine.yaml").write_text(
        "like: flat\nparameters: mine\nfloor.friction: [0.2, 0.2, 0.2, 0.2]\n"
    )
    found = read_parts("mine")
    robot, scene = found.robot, found.scene
    assert (robot.leg.young_modulus, robot.torso.mass) == (2.0e7, 2.2)
    assert found.servo.motor_time == 0.02
    assert (scene.floor.friction[0], scene.tendons.slack[1]) == (0.2, -0.0005)
    assert read_robot().torso.mass == 2.0
    with pytest.raises(
        config.ConfigError, match=r"--set mine: .* exists; it stays as it is"
    ):
        twin_fit.place_of("mine")


def test_an_interrupted_fit_takes_up_its_own_trials_and_deletes_them_at_its_end(
    recorded, tmp_path
):
    runs, points = [], [np.ones(2), np.full(2, 3.0)]

    def run(point):
        runs.append(point)
        return point**2

    for period in (0.7, 0.7, 0.8):
        fit = (
            recorded,
            find_strides(recorded, SETTINGS, period),
            PARTS,
            SETTINGS,
        )
        trials = twin._Trials(tmp_path / "trials", serially, fit)
        assert trials(run, points)[1].tolist() == [9.0, 9.0]
    assert len(runs) == 4
    trials.forget()
    assert sum(path.is_file() for path in (tmp_path / "trials").rglob("*")) == 2
