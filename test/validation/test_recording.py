"""Recordings in CSV are read as documented, or refused in one line with the line's number.

The paper's metrics with their intervals, and the verdict of a comparison.
"""

import math
from pathlib import Path

import numpy as np
import pytest
from bag_messages import message, write_messages

from slot_lab.bags.topics import ESTIMATE, LEG_STATES
from slot_lab.csv_table import TableError, write_points
from slot_lab.validation import validate
from slot_lab.validation.comparison import errors
from slot_lab.validation.recording import read_recording
from slot_lab.verdict import EXPLAINED, NOT_EXPLAINED, Verdict

EXAMPLE = Path(__file__).parents[2] / "slot_bringup" / "example"
ROWS = [f"{n / 30:.4f},0.1,0.0,{0.01 * n}" for n in range(10)]
HEAD = "time,x,y,z"
TUM = [f"{1.7e9 + n / 30:.4f} 0.1 0 {0.01 * n}" for n in range(10)]


@pytest.fixture
def csv(tmp_path):
    def write(*lines):
        (tmp_path / "m.csv").write_text("\n".join(lines) + "\n")
        return tmp_path / "m.csv"

    return write


def test_a_table_is_the_torso_and_its_yaw_unwrapped(csv):
    rows = [
        f"{row},0,0.1,{yaw}"
        for row, yaw in zip(ROWS, [3.0, 3.1, -3.1, -3.0, *[-2.9] * 6])
    ]
    track = read_recording(
        csv("# a comment", f"{HEAD},roll,pitch,yaw", *rows)
    ).points["torso"]
    assert track.t[-1] == pytest.approx(0.3)
    assert track.position[3] == pytest.approx([0.1, 0.0, 0.03])
    assert track.rpy[3] == pytest.approx([0.0, 0.1, 2 * np.pi - 3.0])


def test_a_trajectory_of_tum_is_the_torso(csv):
    turned = [
        f"{row} 0 0 {math.sin(0.4 * n)} {math.cos(0.4 * n)}"
        for n, row in enumerate(TUM)
    ]
    track = read_recording(csv("# time x y z qx qy qz qw", *turned)).points[
        "torso"
    ]
    assert track.t == pytest.approx(np.arange(10) / 30, abs=1e-4)
    assert track.position[3] == pytest.approx([0.1, 0.0, 0.03])
    assert track.rpy[:, 2] == pytest.approx(0.8 * np.arange(10))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "is empty"),
        ([HEAD], "no samples"),
        (
            ["a,b,c"],
            r"line 1: columns a,b,c: expected time,point,x,y,z or time,x,y,z\[",
        ),
        ([HEAD, *ROWS[:3]], "torso has 3 samples, less than 8"),
        (
            [HEAD, *ROWS, "0.4,nan,0,0"],
            r"line 12, x: 'nan' is not a finite number",
        ),
        ([HEAD, *ROWS, "0.4,,0,0"], r"line 12, x: '' is not a finite number"),
        ([HEAD, *ROWS, "0.4,0,0"], "line 12: 3 cells, 4 columns"),
        (
            [HEAD, *ROWS, ROWS[-1]],
            "line 12, time: does not increase after line 11",
        ),
        (
            [HEAD, *ROWS, ROWS[4]],
            "line 12, time: does not increase after line 11",
        ),
        (
            ["time,point,x,y,z", "0,nose,1,2,3"],
            r"line 2, point: 'nose' is unknown",
        ),
        (
            [HEAD, *(f"{1763600000000 + 33 * n},0,0,0" for n in range(10))],
            "line 2, time: median step 33, so likely in ms; expected s",
        ),
        (
            [HEAD, *(f"{1.7636e18 + 33e6 * n:.0f},0,0,0" for n in range(10))],
            "likely in ns",
        ),
        (
            [HEAD, *ROWS, "1.7e9,0,0,0"],
            r"time: steps by 1.7e\+09 s to 1700000000 s, limit 600 s: was the",
        ),
        (
            [HEAD, *(f"{n // 2 * 400 + n % 2 / 99},0,0,0" for n in range(80))],
            r"time: spans 1.56e\+04 s, limit 14400 s: cut the recording",
        ),
        (
            [f"{row} 0 0 0.6 0" for row in TUM],
            "qx qy qz qw of sample 0 have the length 0.6, expected 1",
        ),
        (
            ["version https://git-lfs.github.com/spec/v1", "size 9"],
            "m.csv: a pointer of Git LFS in place of the file: git lfs pull",
        ),
    ],
)
def test_a_bad_table_is_refused_with_its_line(csv, lines, message):
    with pytest.raises(TableError, match=message):
        read_recording(csv(*lines))


def test_recordings_without_a_common_point_are_refused(csv, refusal):
    line = refusal(
        validate.main,
        str(EXAMPLE / "single_leg_run.csv"),
        str(csv(HEAD, *ROWS)),
    )
    assert (
        "no common point: single_leg_run.csv has base, third, two_thirds, tip"
        in line
    )


def test_the_shipped_single_leg_gives_the_papers_table_and_plots(
    tmp_path, capsys
):
    files = [
        str(EXAMPLE / f"single_leg_{name}.csv") for name in ("run", "markers")
    ]
    # another robot
    assert validate.main([*files, "--out", str(tmp_path)]) == NOT_EXPLAINED
    text = capsys.readouterr().out
    assert "verdict: not explained: chi-square" in text.splitlines()[-1]
    assert "largest: base z" in text.splitlines()[-1]
    assert (tmp_path / "summary.txt").read_text().splitlines()[
        -1
    ] == text.splitlines()[-1]
    assert (tmp_path / "leg.png").stat().st_size > 10_000
    rows = (tmp_path / "errors.csv").read_text().splitlines()
    assert len(rows) == 1 + 4 * 3
    # mm, base z: another robot
    assert 1.0 < float(rows[3].split(",")[4]) * 1e3 < 20.0


def test_tracks_in_the_axes_of_a_camera_are_only_compared_with_a_free_rotation(
    tmp_path, capsys, refusal
):
    t = np.arange(60) / 30
    samples = [
        (x, "torso", np.array([0.05 * x, 0.0, 0.01 * np.sin(9 * x)])) for x in t
    ]
    for frame in ("odom", "camera_link"):
        write_points(tmp_path / f"{frame}.csv", samples, [f"frame: {frame}"])
    odom, camera = (
        str(tmp_path / f"{frame}.csv") for frame in ("odom", "camera_link")
    )
    out = ["--out", str(tmp_path / "out")]
    line = refusal(validate.main, odom, camera, *out)
    assert "the tracks are in its axes; align them with --frame rigid" in line
    assert validate.main([odom, camera, "--frame", "rigid", *out]) == EXPLAINED
    assert (
        capsys.readouterr()
        .out.splitlines()[-1]
        .startswith("verdict: explained: chi-square")
    )


def test_legs_of_two_nodes_have_no_points(tmp_path):
    """The tabulated robot's clamp and foot say nothing about the leg between them."""
    entries = []
    for n in range(12):
        legs = message(LEG_STATES, n / 30, nodes=2, position=np.zeros(24))
        entries += [
            (n, LEG_STATES, legs),
            (n, ESTIMATE, message(ESTIMATE, n / 30)),
        ]
    found = read_recording(write_messages(tmp_path / "bag", entries))
    assert set(found.points) == {"torso"}
    assert found.notes == ["legs of 2 nodes: no points along them"]


T = np.arange(3000) / 100.0


def test_metrics_of_an_offset_and_an_oscillation_are_those_of_the_closed_forms():
    measured = 0.05 * np.sin(2 * np.pi * T)
    value = errors(
        measured + 0.004 + 0.003 * np.sin(np.pi * T), measured, 100
    ).value
    assert value["rmse"] == pytest.approx(np.hypot(0.004, 0.003 / np.sqrt(2)))
    assert value["mean_error"] == pytest.approx(0.004)
    assert value["nrmse"] == pytest.approx(value["rmse"] / 0.1)
    assert value["error"] == pytest.approx(0.04)
    assert value["accuracy"] == pytest.approx(0.96)


def test_an_interval_contains_the_truth_in_most_series_and_widens_with_correlation():
    rng, hits, widths = np.random.default_rng(0), 0, []
    for smooth in (1, 20):
        for _ in range(30):
            noise = np.convolve(
                rng.normal(size=900), np.ones(smooth), "valid"
            ) / np.sqrt(smooth)
            low, high = errors(noise, np.zeros(len(noise)), 60).interval["rmse"]
            hits += low <= 1.0 <= high
            widths.append(high - low)
    # of 60; 57 are expected, and blocks of finite length give fewer
    assert hits >= 48
    assert np.mean(widths[30:]) > 1.5 * np.mean(widths[:30])


def test_few_blocks_have_no_interval_and_no_range_no_relative_error():
    assert np.isnan(
        errors(np.ones(50), np.zeros(50), 20).interval["rmse"]
    ).all()
    assert np.isnan(errors(np.ones(50), np.zeros(50), 5).value["accuracy"])


def test_the_interval_of_a_mean_error_near_zero_begins_at_zero():
    noise = np.random.default_rng(0).normal(size=900)
    measured = np.linspace(0.0, 100.0, 900)
    found = errors(
        measured + noise - noise.mean() + 0.001, measured, 30
    ).interval
    assert found["mean_error"][0] == 0.0
    assert found["accuracy"][1] == 1.0


@pytest.mark.parametrize(
    ("given", "code", "said"),
    [
        (
            Verdict(30.0, 20),
            EXPLAINED,
            "explained: chi-square 30 on 20 degrees of",
        ),
        # no chance
        (
            Verdict(2100.0, 1000),
            NOT_EXPLAINED,
            "2.1 each, limit 2",
        ),
        (Verdict(9.0, 2), EXPLAINED, "4.5 each, limit 4.61"),  # 1 % by chance
        (Verdict(math.nan, 10), NOT_EXPLAINED, "nan"),
        (
            Verdict(1.0, 10, ["friction"]),
            NOT_EXPLAINED,
            "at its bound: friction",
        ),
        (Verdict(0.0, 0), NOT_EXPLAINED, "no more data than free parameters"),
    ],
)
def test_a_verdict_is_by_the_residuals_per_degree_of_freedom_and_the_bounds(
    given, code, said
):
    assert given.code == code
    assert said in given.line
