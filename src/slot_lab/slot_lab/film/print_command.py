"""Writes the boards and markers of config/vision.yaml to print at their true size.

NAME is a board of vision.yaml (wall, torso, ...), points for the single markers of torso and legs,
or chessboard for the ChArUco board of scripts/calibrate --camera. A PDF has the true size if it is
printed at 100 %, without fitting to the page; measure the line that is printed with it. A PNG has
its resolution in the file.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import command_parser, within
from slot_lab.desk_command import run_command

FORMATS = (".png", ".pdf")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/calibrate --print`; exit code 2 for a wrong argument."""
    parser = command_parser("calibrate --print", __doc__)
    add = parser.add_argument
    add("what", metavar="NAME", help="name of a board, points, or chessboard")
    add(
        "--out",
        type=Path,
        metavar="FILE",
        required=True,
        help="PNG or PDF to write",
    )
    add(
        "--dpi",
        type=within(50, 1200),
        default=300,
        metavar="N",
        help="dots per inch (default: 300)",
    )
    options = parser.parse_args(arguments)
    if options.out.suffix.lower() not in FORMATS:
        parser.error(
            f"--out {options.out}: the name of a print ends in {' or '.join(FORMATS)}"
        )
    from slot_lab.film.print_markers import run  # noqa: PLC0415 - heavy

    return run_command(parser, options, run)


if __name__ == "__main__":
    sys.exit(main())
