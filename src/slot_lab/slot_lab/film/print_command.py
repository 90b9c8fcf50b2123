"""Writes the boards and markers of config/vision.yaml to print at their true size.

WHAT is a board of vision.yaml (wall, torso, ...), points for the single markers of torso and legs,
or chessboard for the ChArUco board of scripts/calibrate --camera. A PDF has the true size if it is
printed at 100 %, without fitting to the page; measure the line that is printed with it. A PNG has
its resolution in the file.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import command_parser, show, within
from slot_core.refusal import InputError

FORMATS = (".png", ".pdf")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/calibrate --print`; one line and exit code 2 for a wrong argument."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.out.suffix.lower() not in FORMATS:
        parser.error(
            f"--out {options.out}: the name of a print ends in {' or '.join(FORMATS)}"
        )
    from slot_lab.film.print_markers import print_sheet  # noqa: PLC0415 - heavy

    try:
        size = print_sheet(options.what, options.out, options.dpi)
    except InputError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"--out {options.out}: {error.strerror or error}")
    return 0 if show(parser.prog, [f"{options.out}: {size}"]) else 2


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("calibrate --print", __doc__)
    add = parser.add_argument
    add("what", metavar="NAME", help="name of a board, points, or chessboard")
    add("--out", type=Path, metavar="FILE", required=True, help="PNG or PDF to write")
    dots = "dots per inch (default: 300)"
    add("--dpi", type=within(50, 1200), default=300, metavar="N", help=dots)
    return parser


if __name__ == "__main__":
    sys.exit(main())
