"""The line of progress: nothing for short work, one line on a terminal, plain lines elsewhere."""

import io
import threading

import pytest

from slot_core.command_line import DELAY, REPEAT, REWRITE, ProgressLine


class Shown(ProgressLine):
    """Progress of a program, whose thread does not run, with an output and a clock."""

    def __init__(self, terminal=False):
        self.out, self.now = io.StringIO(), 100.0
        self.out.isatty = lambda: terminal
        super().__init__("scripts/x", self.out, lambda: self.now)

    def after(self, seconds):
        """Lines that are shown after a time."""
        self.now += seconds
        self.refresh()
        return "" if self.out.closed else self.out.getvalue()


def test_elsewhere_a_plain_line_comes_after_the_delay_and_then_now_and_then():
    progress = Shown()
    progress("reading")
    texts = [progress.after(0.25) for _ in range(round(4 * (DELAY + REPEAT)))]
    assert texts[-1] == "scripts/x: reading, 3 s\nscripts/x: reading, 8 s\n"


def test_on_a_terminal_the_line_is_rewritten_and_removed():
    progress = Shown(terminal=True)
    progress("reading a long name")
    progress.after(DELAY)
    progress("drawing")
    progress.after(2 * REWRITE)
    progress.say("wrote x")
    first, last = (
        "scripts/x: reading a long name, 3 s",
        "scripts/x: drawing, 3 s",
    )
    text = f"\r{first}\r{last:<{len(first)}}\r{' ' * len(last)}\rwrote x\n"
    assert progress.out.getvalue() == text


@pytest.mark.parametrize(
    ("told", "end"),
    [
        (
            [("predicting", 0.0), ("predicting", 0.25)],
            "predicting, 25 %, 30 s left",
        ),
        # other words, the same work
        ([("3 of 9", 0.5), ("4 of 9", 0.75)], "4 of 9, 75 %, 10 s left"),
        ([("predicting", 0.9), ("drawing", 0.0)], "drawing, 20 s"),
    ],
)
def test_the_time_left_follows_from_the_share_since_it_was_first_told(
    told, end
):
    progress = Shown()
    for what, share in told:
        progress.now += 10.0
        progress(what, share)
    assert progress.after(0.0) == f"scripts/x: {end}\n"


def test_the_thread_shows_the_line_and_a_closed_output_ends_no_work():
    progress, written = Shown(), threading.Event()
    progress.out.flush = written.set
    with progress:
        progress("reading")
        progress.now += DELAY
        assert written.wait(60.0)
        assert progress.out.getvalue() == "scripts/x: reading, 3 s\n"
        progress.out.close()
        progress.after(2 * REPEAT)
