"""The page of a run: its numbers, that it loads nothing, and what a browser shows of it."""

import base64
import json
import re
import shutil
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from bag_messages import message
from rclpy.serialization import serialize_message

from slot_core.drawing.drawing import NATURAL_NODES
from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.record_settings import read_record_settings
from slot_core.robot import read_robot
from slot_lab.bags.bag import Bag
from slot_lab.report.run_page import run_page
from slot_lab.report.run_page.run_page import (
    ALONG,
    NO_VALUE,
    content,
    page,
    read_frames,
    write_page,
)

WALK = Path(__file__).parents[1] / "bags" / "walk"
ROBOT = read_robot()
CHROMIUM = shutil.which("chromium") or ""


@pytest.fixture(scope="module")
def bag():
    return Bag(WALK)


@pytest.fixture(scope="module")
def frames(bag):
    return read_frames(bag, ROBOT)


def copy_of(bag, path, *topics, since=0, **changed):
    """A bag of topics of another since a time, ns, some of which have other data."""
    with BagWriter(path, read_record_settings(), bag.origin) as out:
        for topic, time, data in bag.raw(*topics):
            if time >= since:
                kind = bag.topics[topic]
                out.write(topic, kind, time, changed.get(topic, data))
    return Bag(path)


def inside(text, name):
    """Text of the page's element with an id."""
    return re.search(rf'id="{name}"[^>]*>(.*?)</', text, re.DOTALL)[1]


def decoded(run):
    """Columns of a run by name, from what the page holds."""
    width = sum(count for _, count, _ in run["columns"])
    planes = np.frombuffer(
        zlib.decompress(base64.b64decode(run["data"])), np.uint8
    ).reshape(4, -1)
    signed = np.ascontiguousarray(planes.T).view("<u4")[:, 0]
    signed = signed.reshape(width, run["frames"]).T
    change = (signed >> 1).astype(np.int64) ^ -(signed & 1).astype(np.int64)
    table, found, at = change.cumsum(axis=0).astype(np.int32), {}, 0
    for name, count, step in run["columns"]:
        integers, at = table[:, at : at + count], at + count
        if name in ALONG:
            nodes = integers.reshape(len(integers), 4, -1, 3)
            integers = (
                nodes.cumsum(axis=2).astype(np.int32).reshape(integers.shape)
            )
        found[name] = (
            np.where(integers == NO_VALUE, np.nan, integers * step),
            step,
        )
    return found


def test_frames_are_the_recorded_states_of_the_legs(bag, frames):
    legs = bag.series("/ground_truth/legs", "position", "ground_force")
    truth = bag.series("/ground_truth/odom", "pose.pose.position")
    assert frames.count == len(legs) > 40
    assert (legs.stamp == truth.stamp).all()
    assert frames.columns["t"][:, 0] == pytest.approx(
        (legs.stamp - legs.stamp[0]) * 1e-9, abs=1e-8
    )
    place = truth["pose.pose.position"]
    assert frames.columns["position"] == pytest.approx(place, abs=1e-9)
    nodes = frames.columns["nodes"].reshape(frames.count, -1, 3)
    # single precision
    assert (nodes + place[:, None]).ravel() == pytest.approx(
        legs["position"].ravel(), abs=1e-6
    )
    assert frames.columns["force"].ravel() == pytest.approx(
        legs["ground_force"].ravel(), abs=1e-6
    )
    assert frames.columns["height/true"][:, 0] == pytest.approx(
        1e3 * place[:, 2]
    )
    assert [name for _, name in frames.states["MPC"]] == ["SOLVED"]


def test_a_page_holds_every_column_to_half_a_step(frames):
    shown = decoded(frames.coded())
    assert shown.keys() == frames.columns.keys()
    for name, (values, step) in shown.items():
        off = np.abs(values - frames.columns[name])
        assert np.nanmax(off) <= step / 2 * (1 + 1e-6), name
        assert (np.isnan(values) == np.isnan(frames.columns[name])).all(), name


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300, 2.0**31])
def test_a_value_that_is_not_finite_or_too_large_is_no_value(value):
    integers = run_page._integers(np.array([[1.0], [value], [-2.0]]), 1.0)
    assert integers[:, 0].tolist() == [1, NO_VALUE, -2]


def test_thinned_frames_and_curves_that_cannot_be_read_are_said(
    bag, tmp_path, monkeypatch
):
    """Previews without stages."""
    empty = {"/gait_preview": serialize_message(message("/gait_preview", 1.0))}
    odd = copy_of(bag, tmp_path / "walk", **empty)
    monkeypatch.setattr(run_page, "MOST_FRAMES", 10)
    first, second = write_page([odd], tmp_path / "walk.html")
    assert re.search(r"walk\.html: walk 10 frames \(one of 5\), \d+ kB$", first)
    assert second.startswith(
        f"left out: {odd.path}: /gait_preview cannot be used: "
    )


def test_legs_of_unknown_shape_are_those_without_stress(bag, tmp_path):
    frames = read_frames(copy_of(bag, tmp_path / "blind", "/mpc_state"), ROBOT)
    count = len(set(bag.series("/mpc_state", "validity").stamp))
    assert not frames.known
    assert frames.columns["nodes"].shape == (count, 4 * NATURAL_NODES * 3)
    assert not frames.columns["force"].any()


def test_a_page_loads_nothing_from_anywhere(frames):
    text = page(content([frames, frames], ROBOT))
    assert not re.search(
        r"https?:|//[\w-]+\.\w|url\(|@import|fetch\(|XMLHttp|WebSocket", text
    )
    assert not re.search(
        r"<[a-z][^<>]*\s(src|href|srcset|data|action|poster)=", text
    )
    (policy,) = re.findall(
        r'Content-Security-Policy"\s+content="([^"]*)"', text
    )
    assert policy.split("; ") == [
        "default-src 'none'",
        "script-src 'unsafe-inline' blob:",
        "style-src 'unsafe-inline'",
    ]
    three = [inside(text, name) for name in ("three-core", "three-module")]
    code = b"".join(zlib.decompress(base64.b64decode(part)) for part in three)
    assert set(re.findall(rb"https?://[\w./-]*", code)) == {
        b"http://www.w3.org/1999/xhtml"  # a name, which is not loaded
    }
    assert "Copyright © 2010-2025 three.js authors" in text
    assert "Permission is hereby granted, free of charge" in text


def test_the_name_of_a_bag_cannot_leave_its_place(frames, bag, tmp_path):
    name = "<script>alert(1)<!--"
    bag.save(tmp_path / name)
    text = page(content([read_frames(Bag(tmp_path / name), ROBOT)], ROBOT))
    assert text.count("<script") == 4
    assert json.loads(inside(text, "content"))["runs"][0]["name"] == name


def browsed(path, place, tmp_path):
    """The page's elements after its script has run, in a browser without a network."""
    command = [
        CHROMIUM,
        "--headless=new",
        "--no-sandbox",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--host-resolver-rules=MAP * ~NOTFOUND",
        "--virtual-time-budget=3000",
        f"--user-data-dir={tmp_path / 'profile'}",
        "--dump-dom",
        f"file://{path}#{place}",
    ]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=300, check=True
    ).stdout


@pytest.mark.skipif(
    not CHROMIUM, reason="Chromium is missing: no page was opened"
)
@pytest.mark.skipif(
    "/snap/" in CHROMIUM, reason="Chromium is a snap, which cannot read /tmp"
)
def test_a_browser_shows_the_values_of_both_runs_and_how_far_they_are_apart(
    bag, frames, tmp_path
):
    """Between two frames the values are interpolated."""
    legs = bag.series("/ground_truth/legs", "nodes")
    other = copy_of(bag, tmp_path / "later", since=legs.time[12])
    write_page([bag, other], tmp_path / "both.html")
    text = browsed(tmp_path / "both.html", "t=0.75&layout=over", tmp_path)
    runs = frames, read_frames(other, ROBOT)
    assert f'data-ready="{runs[0].count} {runs[1].count}"' in text
    assert "data-error" not in text
    words = re.sub(r"<[^>]+>", "", text.partition("<script")[0])
    assert float(re.search(r"0\.75 of ([\d.]+) s", words)[1]) == (
        pytest.approx(frames.columns["t"][-1, 0], abs=0.01)
    )
    assert re.search("first: .*MPC SOLVED", words)

    def at(run, name):
        rows = run.columns[name].T
        return np.array(
            [np.interp(0.75, run.columns["t"][:, 0], r) for r in rows]
        )

    shown = re.findall(r"true (-?[\d.]+) \| (-?[\d.]+)", words)[0]
    speeds = [at(run, "velocity/true")[0] for run in runs]
    assert [*map(float, shown)] == pytest.approx(speeds, abs=1e-3)
    places = [at(run, "position") for run in runs]
    feet = [
        place + at(run, "nodes").reshape(4, -1, 3)[:, -1]
        for run, place in zip(runs, places)
    ]
    said = re.search(
        r"torsos ([\d.]+) mm apart, feet at most ([\d.]+) mm", words
    ).groups()
    apart = [
        np.linalg.norm(np.subtract(*both), axis=-1) for both in (places, feet)
    ]
    assert float(said[0]) == pytest.approx(1e3 * apart[0], abs=0.1)
    assert float(said[1]) == pytest.approx(1e3 * apart[1].max(), abs=0.2)
