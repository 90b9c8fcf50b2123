"""What the command lines of this package share."""

from __future__ import annotations

import argparse
import sys

from slot_core.command_line import CommandParser

INTERRUPTED = 130  # exit code


def command_parser(name: str, description: str | None) -> CommandParser:
    """Parser of `scripts/NAME`, whose help shows the description as it is written."""
    form = argparse.RawDescriptionHelpFormatter
    return CommandParser(prog=f"scripts/{name}", description=description, formatter_class=form)


def one_line(error: BaseException) -> str:
    """The message of an error without line breaks."""
    return " ".join(str(error).split())


def progress(line: str) -> None:
    """Print a line of progress."""
    print(line, file=sys.stderr, flush=True)
