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
        (["nowhere"], "nowhere: does not exist"),
        ([str(Path(__file__).parent)], "bringup: "),
        ([str(BAG)], r"rerun-sdk is missing; run scripts/setup --view"),
        ([str(BAG), "--animate", "walk.mp4"], r"walk\.mp4: expected a name that ends in \.gif"),
        ([str(BAG), "--animate", "/no/such/walk.gif"], "/no/such/walk.gif: No such file"),
        (["--live", "--namespace", "a b"], "namespace = 'a b'"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(arguments, line, capfd):
    assert view.main(arguments) == 2
    out, error = capfd.readouterr()
    assert not out
    assert len(error.splitlines()) == 1
    assert error.startswith("scripts/view: ")
    assert re.search(line, error)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--live", "bag"],
        ["--live", "--animate", "x.gif"],
        ["--no-browser"],
        ["--web", "--save", "x.rrd"],
        ["one", "two"],
    ],
)
def test_options_that_exclude_each_other_are_refused_in_one_line(arguments, capsys):
    with pytest.raises(SystemExit) as end:
        view.main(arguments)
    assert end.value.code == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_without_a_display_the_browser_is_named(monkeypatch, capsys):
    monkeypatch.setattr(view, "require_rerun", lambda: None)
    assert view.main([str(BAG)]) == 2
    assert "no display: use --web for a browser" in capsys.readouterr().err


def test_the_newest_bag_is_shown_by_default(tmp_path):
    for i, name in enumerate(("walk_2", "walk_1", "pictures_of_a_film")):
        (tmp_path / name).mkdir()
        if name.startswith("walk"):
            (tmp_path / name / "walk.mcap").touch()
        os.utime(tmp_path / name, (time.time() + i, time.time() + i))
    (tmp_path / "note.txt").touch()
    assert view.newest_bag(tmp_path) == tmp_path / "walk_1"


def test_a_viewer_that_does_not_start_is_reported_with_its_last_line_and_may_ask_nobody(
    monkeypatch, tmp_path
):
    program = tmp_path / "rerun"
    program.write_text("#!/bin/sh\necho first\necho CI $CI, proxy $HTTPS_PROXY\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setattr(rerun_viewer.sys, "executable", str(tmp_path / "python"))
    with pytest.raises(
        rerun_viewer.ViewerError, match=r"rerun ended: CI 1, proxy http://127\.0\.0\.1:9"
    ):
        rerun_viewer.Viewer(web=False, log=tmp_path / "log")


def test_an_interrupt_while_the_viewer_starts_ends_it(monkeypatch, tmp_path):
    program = tmp_path / "rerun"
    program.write_text("#!/bin/sh\nexec sleep 100\n")
    program.chmod(0o755)
    started = []

    def interrupt(viewer, *_):
        started.append(viewer)
        raise KeyboardInterrupt

    monkeypatch.setattr(rerun_viewer.sys, "executable", str(tmp_path / "python"))
    monkeypatch.setattr(rerun_viewer.Viewer, "_await", interrupt)
    with pytest.raises(KeyboardInterrupt):
        rerun_viewer.Viewer(web=False, log=tmp_path / "log")
    assert started[0].closed


def test_the_page_is_handed_on_with_a_policy_that_names_this_machine_alone(monkeypatch, tmp_path):
    program = tmp_path / "rerun"
    program.write_text(
        "#!/bin/sh\nwhile [ $1 != --web-viewer-port ]; do shift; done\n"
        'cd "$(dirname "$0")"\necho page > index.html\n'
        "exec python3 -m http.server --bind 127.0.0.1 $2\n"
    )
    program.chmod(0o755)
    monkeypatch.setattr(rerun_viewer.sys, "executable", str(tmp_path / "python"))
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")  # without no_proxy
    viewer = rerun_viewer.Viewer(web=True, log=tmp_path / "log")
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
