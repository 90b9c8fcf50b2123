"""scripts/view: which run it shows, where it writes its page, and when it opens a browser."""

import os
import time
from pathlib import Path

from synthetic_walk import Walk, write_walk

from slot_bringup import view
from slot_bringup.playing import main_page


def test_a_run_is_written_into_its_folder_and_opened(
    monkeypatch, refusal, tmp_path
):
    """On a machine with a display."""
    opened = []
    monkeypatch.setattr(main_page.webbrowser, "open", opened.append)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.chdir(tmp_path)
    line = refusal(view.main)
    assert line.startswith("scripts/view: no bag in /")
    assert "/bags: name one, or make one by scripts/run" in line
    bag = write_walk(Path("bags/walk"), Walk(duration=1.0))
    page = bag.absolute() / view.PAGE
    for words in ([], ["--no-browser"], ["--html", "other.html"]):
        assert view.main(words) == 0
    monkeypatch.delenv("DISPLAY")
    assert view.main([str(bag)]) == 0
    assert page.exists()
    assert opened == [page.as_uri()]


def test_the_newest_bag_is_shown_by_default(tmp_path):
    newest, older = (tmp_path / f"walk_{i}" / "walk.mcap" for i in (2, 1))
    for age, file in enumerate([newest, older]):
        file.parent.mkdir()
        file.touch()
        os.utime(file, (1e9 - age, 1e9 - age))
    older.with_name(view.PAGE).touch()  # of an older run that was shown last
    (tmp_path / "plots_of_a_film").mkdir()
    assert view.newest_bag(tmp_path) == newest.parent


def test_the_live_page_of_a_run_waits_for_its_graph_and_ends_with_it(
    monkeypatch, tmp_path
):
    program, words, done = (
        tmp_path / "python",
        tmp_path / "words",
        tmp_path / "done",
    )
    program.write_text(
        f"#!/bin/sh\ntrap 'touch {done}; exit' TERM\necho $@ >{words}.new\nmv {words}.new {words}\n"
        "while :; do sleep 0.1; done\n"
    )
    program.chmod(0o755)
    monkeypatch.setattr(main_page.sys, "executable", str(program))
    with main_page.live_page("fred", 90.0):
        while not words.exists():
            time.sleep(0.01)
        assert not done.exists()
    assert done.exists()
    assert "--graph --namespace fred --wait 90.0 --open" in words.read_text()
