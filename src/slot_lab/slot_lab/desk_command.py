"""Run of a desk command: progress on standard error, its lines, its exit code, its plot."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from slot_core.command_line import (
    INTERRUPTED,
    ProgressLine,
    missing,
    refuse,
    show,
)
from slot_core.refusal import DivergenceError, InputError

if TYPE_CHECKING:  # heavy
    from matplotlib.figure import Figure

UNUSABLE = 2  # exit code
Outcome = tuple[Sequence[str], int]
"""Lines to print, and the exit code."""


def run_command(
    parser: argparse.ArgumentParser,
    options: argparse.Namespace,
    work: Callable[[argparse.Namespace, ProgressLine], Outcome],
    *,
    resumable: bool = False,
) -> int:
    """Do the work of a command and print its lines; returns its exit code.

    What cannot be used, computed or written gives one line and the code UNUSABLE.
    resumable: the same command continues work that was interrupted, and says so.
    """
    if resumable:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with ProgressLine(parser.prog) as progress:
            lines, code = work(options, progress)
    except (InputError, DivergenceError) as error:
        reason = str(error)
    except ModuleNotFoundError as error:
        reason = missing(error.name)
    except OSError as error:
        reason = f"{error.filename or 'output'}: {error.strerror or error}"
    except KeyboardInterrupt:
        if not resumable:
            raise
        print(
            f"\n{parser.prog}: interrupted; the same command continues",
            file=sys.stderr,
        )
        return INTERRUPTED
    else:
        return code if show(parser.prog, lines) else UNUSABLE
    refuse(parser.prog, reason)
    return UNUSABLE


def write_plot(figure: Figure, path: Path, dpi: int) -> None:
    """Write a figure, in a directory that is made; raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
