"""The page of a run: its numbers, that it loads nothing, and what a browser shows of it."""

import base64
import json
import re
import shutil
import subprocess
import zlib

import numpy as np
import pytest
from synthetic_walk import (
    NODES,
    ROBOT,
    Walk,
    leg_nodes,
    normal_forces,
    write_walk,
)

from slot_core.drawing.drawing import NATURAL_NODES
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

WALK = Walk(duration=1.0, roll=0.1, bounce=0.004, speed=0.2)
CHROMIUM = shutil.which("chromium") or ""


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return Bag(write_walk(tmp_path_factory.mktemp("bags") / "walk", WALK))


@pytest.fixture(scope="module")
def frames(bag):
    return read_frames(bag, ROBOT)


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


def test_frames_are_the_recorded_states_of_the_legs(frames):
    t = frames.columns["t"][:, 0]
    assert frames.count == 31  # the legs' states come at 30 Hz
    assert t == pytest.approx(np.arange(31) / 30, abs=1e-8)
    place = np.array([WALK.position(time) for time in t])
    assert frames.columns["position"] == pytest.approx(place, abs=1e-9)
    nodes = (
        frames.columns["nodes"].reshape(-1, 4, NODES, 3) + place[:, None, None]
    )
    # single precision
    assert nodes[7] == pytest.approx(leg_nodes(WALK, t[7]), abs=1e-6)
    force = frames.columns["force"].reshape(-1, 4, 3)[:, :, 2]
    assert force[9] == pytest.approx(1.05 * normal_forces(t[9] - 0.03))
    assert frames.columns["height/true"][:, 0] == pytest.approx(
        1e3 * place[:, 2]
    )
    assert frames.states["MPC"] == [(0.0, "SOLVED")]


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
    """The previews of the synthetic walk have no stages."""
    monkeypatch.setattr(run_page, "MOST_FRAMES", 10)
    first, second = write_page([bag], tmp_path / "walk.html")
    assert re.search(r"walk\.html: walk 8 frames \(one of 4\), \d+ kB$", first)
    assert second.startswith(
        f"left out: {bag.path}: /gait_preview cannot be used: "
    )


def test_legs_of_unknown_shape_are_those_without_stress(tmp_path):
    blind = Bag(write_walk(tmp_path / "blind", Walk(duration=0.3, truth=False)))
    frames = read_frames(blind, ROBOT)
    assert not frames.known
    assert frames.columns["nodes"].shape == (10, 4 * NATURAL_NODES * 3)
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
    bag, tmp_path
):
    other = Walk(duration=0.8, roll=0.1, bounce=0.004, speed=0.23)
    second = Bag(write_walk(tmp_path / "second", other))
    write_page([bag, second], tmp_path / "both.html")
    text = browsed(tmp_path / "both.html", "t=0.75&layout=over", tmp_path)
    assert 'data-ready="31 25"' in text
    assert "data-error" not in text
    words = re.sub(r"<[^>]+>", "", text.partition("<script")[0])
    assert "0.75 of 1.00 s" in words
    assert "first: MPC SOLVED" in words
    # between two frames the values are interpolated: in 33 ms the sine of 0.72 s turns by 0.29 rad
    assert [
        float(x) for x in re.findall(r"true ([\d.]+) \| ([\d.]+)", words)[0]
    ] == [
        0.2,
        0.23,
    ]
    apart, feet = re.search(
        r"torsos ([\d.]+) mm apart, feet at most ([\d.]+) mm", words
    ).groups()
    assert float(apart) == pytest.approx(1e3 * 0.03 * 0.75, abs=0.1)
    assert float(feet) == pytest.approx(1e3 * 0.03 * 0.75, abs=0.2)
