"""Draws the Dynamic Constraint Map of a bag."""

import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import command_parser
from slot_lab.desk_command import run_command


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/view --map`; exit code 0: clean, 1: a violation, 2: no map."""
    parser = command_parser("view --map", __doc__)
    add = parser.add_argument
    add(
        "bag",
        metavar="BAG",
        type=Path,
        help="directory of a bag, or its .mcap file",
    )
    add("--namespace", metavar="NAME", default="", help="of the recorded graph")
    add("--out", type=Path, metavar="FILE", help="default: BAG_constraints.png")
    options = parser.parse_args(arguments)
    if options.out and options.out.suffix != ".png":
        parser.error(f"--out {options.out}: the name of a plot ends in .png")
    from slot_lab.report.constraint_map import run  # noqa: PLC0415 - heavy

    return run_command(parser, options, run)


if __name__ == "__main__":
    sys.exit(main())
