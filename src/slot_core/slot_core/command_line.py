"""Command lines: one parser, one way to refuse, types of arguments, libraries that are there.

Names of values in a help: BAG, FILE, DIR; RECORDING: a bag, a CSV file or a film; NAME: of a gait,
scene or other thing of config/; N: a number; S: seconds; units: M, DEG, HZ, M/S, RAD/S.
"""

import argparse
import os
import sys
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn, TypeVar

from slot_core.refusal import one_line, printable

Number = TypeVar("Number", int, float)
INTERRUPTED = 130  # exit code
# Libraries that all programs import; scripts/setup installs them below .slot.
LIBRARIES = ("numba", "numpy", "rosbags", "scipy", "yaml")


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
    if _missing():
        venv = Path(os.environ.get("VIRTUAL_ENV", os.devnull))
        sys.path += [
            str(path) for path in venv.glob("lib/python3*/site-packages")
        ]
    if missing := _missing():
        sys.exit(
            f"Python finds no {', '.join(missing)}: in a new terminal first source scripts/env of"
            " the SLOT repository, then install/setup.bash"
        )


def prints_help() -> bool:
    """Whether scripts/help runs the program, which needs no package and finds none."""
    return bool(sys.flags.isolated and sys.flags.no_site)


def _missing() -> list[str]:
    return [name for name in LIBRARIES if find_spec(name) is None]
