"""Progress of a program's work on standard error: task, share that is done, time left."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TextIO

from slot_core.refusal import printable

DELAY = 3.0  # s; work that ends earlier shows nothing
# s between two lines on a terminal, which replace each other; else
REWRITE, REPEAT = 0.2, 5.0
LEAST_SHARE = 0.02  # from which the time left is estimated

Tell = Callable[[float], object]
"""Takes the share of some work that is done, 0 to 1."""


def untold(*_: object) -> None:
    """Receiver of the progress of work that nobody watches."""


class ProgressLine:
    """Line on the work of a `with` block, shown by a thread as long as the block lasts.

    `progress("reading the bag")` says what the block does now.
    """

    def __init__(
        self,
        program: str,
        out: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._program, self._out, self._clock = (
            program,
            out or sys.stderr,
            clock,
        )
        self._terminal = self._out.isatty()
        # of the block; of the task that the share is of
        self._begin = self._since = self._clock()
        # share now, and at the begin of the task
        self._what, self._share, self._first = "", 0.0, 0.0
        # time and length of the last line
        self._shown, self._width = (self._begin, 0)
        self._ended, self._lock = threading.Event(), threading.Lock()
        self._thread = threading.Thread(target=self._repeat, daemon=True)

    def __enter__(self) -> ProgressLine:
        """Begin to show."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the line."""
        self._ended.set()
        self._thread.join()
        with self._lock:
            self._clear()

    def __call__(self, what: str, share: float = 0.0) -> None:
        """Report the task, and the share of it that is done, if known.

        Other words with a larger share go on with the same work.
        """
        if share < self._share or (
            what != self._what and not 0.0 < self._share < share
        ):
            self._since, self._first = self._clock(), share
        self._what, self._share = what, share

    def say(self, line: str) -> None:
        """Print a line that stays."""
        with self._lock:
            self._clear()
            self._print(f"{line}\n")

    def refresh(self) -> None:
        """Show the line if it is time."""
        now = self._clock()
        wait = REWRITE if self._terminal else REPEAT
        if (
            now - self._begin < DELAY
            or not self._what
            or (now - self._shown < wait and self._width)
        ):
            return
        with self._lock:
            line = printable(f"{self._program}: {self._what}{self._times(now)}")
            if self._terminal:
                line = line[: shutil.get_terminal_size().columns - 1]
                self._print(f"\r{line:<{self._width}}")
            else:
                self._print(f"{line}\n")
            self._shown, self._width = now, len(line)

    def _times(self, now: float) -> str:
        """Share and time left, else the time since the begin of the block."""
        done = self._share - self._first
        if done < LEAST_SHARE:
            return f", {now - self._begin:.0f} s"
        left = (now - self._since) * (1.0 - self._share) / done
        return f", {100 * self._share:.0f} %, {left:.0f} s left"

    def _repeat(self) -> None:
        while not self._ended.wait(REWRITE):
            self.refresh()

    def _clear(self) -> None:
        if self._terminal and self._width:
            self._print(f"\r{'':<{self._width}}\r")
            self._width = 0

    def _print(self, text: str) -> None:
        # a closed terminal or pipe ends no work
        with suppress(OSError, ValueError):
            self._out.write(text)
            self._out.flush()
