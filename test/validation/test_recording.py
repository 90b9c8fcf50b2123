"""Recordings in CSV are read as documented, or refused in one line with the line's number."""

from pathlib import Path

import numpy as np
import pytest
from synthetic_walk import message, write_messages

from slot_lab.bags.topics import ESTIMATE, LEG_STATES
from slot_lab.csv_table import TableError, write_points
from slot_lab.validation import validate
from slot_lab.validation.recording import read_recording
from slot_lab.verdict import EXPLAINED, NOT_EXPLAINED

EXAMPLE = Path(__file__).parents[2] / "slot_bringup" / "example"
ROWS = [f"{n / 30:.4f},0.1,0.0,{0.01 * n}" for n in range(10)]
HEAD = "time,x,y,z"


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
