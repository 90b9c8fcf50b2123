"""scripts/view: what it shows by default, and what it refuses in one line; without rerun."""

import importlib.util
import os
import re
import time
from pathlib import Path

import pytest

from slot_bringup import rerun_viewer, view

BAG = Path(__file__).parents[1] / "bags/walk"


@pytest.fixture(autouse=True)
def nowhere(monkeypatch, tmp_path):
    """No rerun, no display, an empty directory."""
    found = importlib.util.find_spec
    hide = {"rerun": None}
    monkeypatch.setattr(importlib.util, "find_spec", lambda n: hide[n] if n in hide else found(n))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ([], "no bag in /.*/bags: name one, or make one by scripts/run"),
        ([str(Path(__file__).parent)], ".*bringup: "),
        ([str(BAG)], r"rerun-sdk is missing; run scripts/setup --view"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(refusal, arguments, line):
    assert re.match(f"scripts/view: {line}", refusal(view.main, *arguments))


def test_without_a_display_the_browser_is_named(monkeypatch, refusal):
    monkeypatch.setattr(view, "require_rerun", lambda: None)
    assert "no display: use --web for a browser" in refusal(view.main, BAG)


def test_the_newest_bag_is_shown_by_default(tmp_path):
    for i, name in enumerate(("walk_2", "walk_1", "plots_of_a_film")):
        (tmp_path / name).mkdir()
        if name.startswith("walk"):
            (tmp_path / name / "walk.mcap").touch()
        os.utime(tmp_path / name, (time.time() + i, time.time() + i))
    (tmp_path / "note.txt").touch()
    assert view.newest_bag(tmp_path) == tmp_path / "walk_1"


@pytest.fixture
def rerun(monkeypatch, tmp_path):
    """A function that puts a shell script in the place of rerun and starts the viewer."""
    monkeypatch.setattr(rerun_viewer.sys, "executable", str(tmp_path / "python"))

    def start(script, web=False):
        program = tmp_path / "rerun"
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        return rerun_viewer.Viewer(web=web, log=tmp_path / "log")

    return start


def test_a_viewer_that_does_not_start_is_reported_with_its_last_line_and_may_ask_nobody(rerun):
    with pytest.raises(
        rerun_viewer.ViewerError, match=r"rerun ended: CI 1, proxy http://127\.0\.0\.1:9"
    ):
        rerun("echo first\necho CI $CI, proxy $HTTPS_PROXY\nexit 3")


def test_an_interrupt_while_the_viewer_starts_ends_it(rerun, monkeypatch):
    started = []

    def interrupt(viewer, *_):
        started.append(viewer)
        raise KeyboardInterrupt

    monkeypatch.setattr(rerun_viewer.Viewer, "_await", interrupt)
    with pytest.raises(KeyboardInterrupt):
        rerun("exec sleep 100")
    assert started[0].closed


SERVER = """while [ $1 != --web-viewer-port ]; do shift; done
cd "$(dirname "$0")"
echo page > index.html
exec python3 -m http.server --bind 127.0.0.1 $2"""


def test_the_page_is_handed_on_with_a_policy_that_names_this_machine_alone(rerun, monkeypatch):
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")  # without no_proxy
    viewer = rerun(SERVER, web=True)
    try:
        with rerun_viewer.DIRECT.open(viewer.page) as answer:
            policy = answer.headers["Content-Security-Policy"]
            assert answer.read() == b"page\n"
        sources = [word for word in policy.split() if "//" in word]
        assert sources == [viewer.address.removeprefix("rerun+").removesuffix("/proxy")]
        assert sources[0].startswith("http://127.0.0.1:")
    finally:
        viewer.stop()
    assert viewer.closed
