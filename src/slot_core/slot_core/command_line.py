"""Command lines: one parser, one way to refuse, types of arguments, libraries that are there.

Names of values in a help: BAG, FILE, DIR; RECORDING: a bag, a CSV file or a film; NAME: of a gait,
scene or other thing of config/; N: a number; S: seconds; units: M, DEG, HZ, M/S, RAD/S.

Progress of a program's work on standard error: task, share that is done, time left.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn, TextIO, TypeVar

from slot_core.refusal import one_line, printable

Number = TypeVar("Number", int, float)
INTERRUPTED = 130  # exit code
# Libraries that all programs import; scripts/setup installs them below .slot.
LIBRARIES = ("numba", "numpy", "rosbags", "scipy", "yaml")
# Modules that some programs import, by the option of scripts/setup that installs them.
EXTRAS = {
    "play": ("viser",),
    "learn": ("distributed", "gymnasium", "onnx", "onnxruntime"),
    "bench": (
        "cma",
        "cvxpy",
        "elastica",
        "gym_softrobot",
        "mujoco",
        "quadprog",
    ),
    "docs": ("myst_parser", "sphinx"),
    "test": ("playwright", "pytest"),
}


class CommandParser(argparse.ArgumentParser):
    """CommandParser that refuses with one line, without the usage, and exit code 2."""

    def error(self, message: str) -> NoReturn:
        """End the program with the message."""
        self.exit(2, one_line(f"{self.prog}: {message}") + "\n")


def command_parser(name: str, description: str | None) -> CommandParser:
    """Parser of `scripts/NAME`, whose help shows the description as it is written."""
    return CommandParser(
        prog=f"scripts/{name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def missing(module: str | None) -> str:
    """Refusal for a module that Python does not find, with what installs it."""
    root = str(module).partition(".")[0]
    options = [f" --{x}" for x, modules in EXTRAS.items() if root in modules]
    return f"{module} is missing; run scripts/setup{''.join(options)}"


def refuse(program: str, error: object) -> None:
    """Print the line in which a program refuses."""
    print(one_line(f"{program}: {error}"), file=sys.stderr)


def show(program: str, lines: Iterable[str]) -> bool:
    """Print lines without control characters; False if the output cannot be written, and say so."""
    try:
        print("\n".join(map(printable, lines)), flush=True)
    except OSError as error:  # a full disk, a closed pipe
        refuse(program, f"output: {error.strerror}")
        # What is left in the buffer must not fail again at the end of the process.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return False
    return True


def progress(line: str) -> None:
    """Print a line of progress."""
    print(line, file=sys.stderr, flush=True)


def require_directory(parser: argparse.ArgumentParser, out: Path) -> None:
    """End the program with one line and code 2 if the file --out is not in an existing directory."""
    if not out.absolute().parent.is_dir():
        parser.error(f"--out {out}: not in an existing directory")


def positive_integer(text: str) -> int:
    """An integer of at least one; raises ArgumentTypeError, ValueError."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is below 1")
    return value


def within(
    low: Number, high: Number, unit: str = ""
) -> Callable[[str], Number]:
    """Type of a number in [low, high] of the kind of its bounds; raises as `positive_integer`."""
    kind, end = type(low), f" {unit}" if unit else ""

    def number(text: str) -> Number:
        value = kind(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(
                f"{text}{end}: outside [{low:g}, {high:g}]{end}"
            )
        return value

    return number


def require_libraries() -> None:
    """End a program with one line if Python does not find a library that all programs import.

    `ros2 launch` runs under the system's Python. In a terminal in which scripts/env was sourced it
    finds here what its own packages lack.
    """
    if prints_help():
        return
    if _absent():
        venv = Path(os.environ.get("VIRTUAL_ENV", os.devnull))
        sys.path += [
            str(path) for path in venv.glob("lib/python3*/site-packages")
        ]
    if absent := _absent():
        sys.exit(
            f"Python finds no {', '.join(absent)}: in a new terminal first source scripts/env of"
            " the SLOT repository, then install/setup.bash"
        )


def prints_help() -> bool:
    """Whether scripts/help runs the program, which needs no package and finds none."""
    return bool(sys.flags.isolated and sys.flags.no_site)


def _absent() -> list[str]:
    return [name for name in LIBRARIES if find_spec(name) is None]


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
