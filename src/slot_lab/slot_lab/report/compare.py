"""Compares two runs: their origins, and every figure of their summaries side by side.

First what differs in revision, policy, arguments, attached files and the values of the
configuration, then the figures, named as in `walk_metrics`: of the first bag, of the second, and
second minus first. A dash stands where a bag lacks the data.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import command_parser, within
from slot_core.refusal import quoted
from slot_lab.desk_command import run_command

EXIT_CODES = """\
Exit code: 0, 1 where a difference exceeds a tolerance, 2 unusable input.
"""
SUFFIXES = (".png", ".pdf", ".svg")  # of a plot


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/compare`; ends with exit code 2 and one line on a bad input."""
    parser = command_parser("compare", f"{__doc__}\n{EXIT_CODES}")
    add = parser.add_argument
    add(
        "bags",
        nargs=2,
        type=Path,
        metavar="BAG",
        help="directory of a bag, or its file",
    )
    add(
        "--tolerance",
        type=_tolerance,
        action="append",
        default=[],
        metavar="FIGURE=N",
        help="largest difference of a figure, in its unit, as height_mean=0.5; patterns of"
        " a shell for several, as '*drift*=2'; may be repeated, the last that matches"
        " counts",
    )
    add(
        "--plot",
        type=Path,
        metavar="FILE",
        help=f"draw both walks: {', '.join(SUFFIXES)}",
    )
    add(
        "--warm-up",
        type=within(0.0, 3600.0, "s"),
        metavar="S",
        help="left out at the start (default: warm_up of config/record.yaml)",
    )
    add(
        "--namespace", default="", metavar="NAME", help="of the recorded graphs"
    )
    options = parser.parse_args(arguments)
    if options.plot and options.plot.suffix not in SUFFIXES:
        parser.error(
            f"{options.plot}: the name of a plot ends in {', '.join(SUFFIXES)}"
        )
    from slot_lab.report.run_comparison import run  # noqa: PLC0415 - heavy

    return run_command(parser, options, run)


def _tolerance(text: str) -> tuple[str, float]:
    pattern, separator, number = text.rpartition("=")
    try:
        largest = float(number)
    except ValueError:
        largest = math.nan
    if not (separator and pattern and 0.0 <= largest < math.inf):
        raise argparse.ArgumentTypeError(
            f"{quoted(text)}: expected FIGURE=N, N in [0, inf)"
        )
    return pattern, largest


if __name__ == "__main__":
    sys.exit(main())
