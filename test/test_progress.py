"""The line of progress: nothing for short work, one line on a terminal, plain lines elsewhere."""

import io
import threading
from types import SimpleNamespace

import pytest

from slot_core.progress import DELAY, REPEAT, REWRITE, ProgressLine


@pytest.fixture
def shown():
    """A function that makes the progress of a program, whose thread does not run, with a clock."""

    def make(terminal):
        out, clock = io.StringIO(), SimpleNamespace(now=100.0)
        out.isatty = lambda: terminal
        return ProgressLine("scripts/x", out, lambda: clock.now), out, clock

    return make


def test_elsewhere_a_plain_line_comes_after_the_delay_and_then_now_and_then(shown):
    progress, out, clock = shown(False)
    progress("reading")
    for _ in range(round(4 * (DELAY + REPEAT))):
        clock.now += 0.25
        progress.refresh()
    assert out.getvalue() == "scripts/x: reading, 3 s\nscripts/x: reading, 8 s\n"


def test_on_a_terminal_the_line_is_rewritten_and_removed(shown):
    progress, out, clock = shown(True)
    progress("reading a long name")
    clock.now += DELAY
    progress.refresh()
    progress("drawing")
    clock.now += 2 * REWRITE
    progress.refresh()
    progress.say("wrote x")
    first, last = "scripts/x: reading a long name, 3 s", "scripts/x: drawing, 3 s"
    blank = " " * len(last)
    assert out.getvalue() == f"\r{first}\r{last:<{len(first)}}\r{blank}\rwrote x\n"


@pytest.mark.parametrize(
    ("told", "end"),
    [
        ([("predicting", 0.0), ("predicting", 0.25)], "predicting, 25 %, 30 s left"),
        (
            [("3 of 9", 0.5), ("4 of 9", 0.75)],
            "4 of 9, 75 %, 10 s left",
        ),  # other words, the same work
        ([("predicting", 0.9), ("drawing", 0.0)], "drawing, 20 s"),
    ],
)
def test_the_time_left_follows_from_the_share_since_it_was_first_told(shown, told, end):
    progress, out, clock = shown(False)
    clock.now += 10.0
    for what, share in told:
        progress(what, share)
        clock.now += 10.0
    clock.now -= 10.0
    progress.refresh()
    assert out.getvalue() == f"scripts/x: {end}\n"


def test_a_closed_output_ends_no_work(shown):
    progress, out, clock = shown(False)
    with progress:
        progress("reading")
        out.close()
        clock.now += DELAY
        progress.refresh()


def test_the_thread_shows_the_line(shown):
    progress, out, clock = shown(False)
    written = threading.Event()
    out.flush = written.set
    with progress:
        progress("reading")
        clock.now += DELAY
        assert written.wait(60.0)
    assert out.getvalue() == "scripts/x: reading, 3 s\n"
