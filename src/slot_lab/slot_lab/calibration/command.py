"""Fits free parameters of a leg to measurements and writes a parameter file.

DATA.csv has one measurement a row: the range of a marker, the force at a tendon angle or a
deflection. slot_lab/calibration/data.py describes the columns;
config/parameters/paper_single_leg.csv is an example.

With another first word, each with a --help:
  --camera    calibrates a camera from images of the chessboard
  --print     writes the boards and markers to print
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import command_parser, positive_integer
from slot_lab.desk_command import run_command
from slot_lab.verdict import EXIT_CODES

FREE = (
    "leg.young_modulus",
    "tendon.offset",
    "tendon.cable_stiffness",
    "tendon.slack",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/calibrate`: prints a table and the verdict.

    Returns its exit code, 2 for invalid data, settings or arguments.
    """
    parser = command_parser("calibrate", f"{__doc__}\n{EXIT_CODES}")
    add = parser.add_argument
    add("data", type=Path, metavar="FILE", help="measurements")
    add(
        "--out",
        type=Path,
        metavar="FILE",
        help="parameter file to write (YAML)",
    )
    add("--plot", type=Path, metavar="FILE", help="plot to write")
    add(
        "--free",
        nargs="+",
        metavar="NAME",
        default=FREE,
        help=f"parameters to fit (default: {' '.join(FREE)})",
    )
    add(
        "--start",
        metavar="NAME",
        default="paper",
        help="set of config/parameters to start from",
    )
    add(
        "--starts",
        type=positive_integer,
        metavar="N",
        default=8,
        help="starts of the fit, scattered about the first (default: 8)",
    )
    add(
        "--evaluate",
        action="store_true",
        help="evaluate the set of --start without a fit",
    )
    add(
        "--note", default="", metavar="TEXT", help="text for the parameter file"
    )
    options = parser.parse_args(arguments)
    if options.plot and options.plot.suffix != ".png":
        parser.error(f"--plot {options.plot}: the name of a plot ends in .png")
    from slot_lab.calibration.calibrate import run  # noqa: PLC0415 - heavy

    return run_command(parser, options, run)


if __name__ == "__main__":
    sys.exit(main())
