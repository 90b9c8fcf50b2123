"""Draws the Dynamic Constraint Map of a bag."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import CommandParser, refuse, show
from slot_core.refusal import InputError


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/view --map`; exit code 0: clean, 1: a violation, 2: no map."""
    parser = CommandParser(prog="scripts/view --map", description=__doc__)
    parser.add_argument(
        "bag", metavar="BAG", type=Path, help="directory of a bag, or its .mcap file"
    )
    parser.add_argument(
        "--namespace", metavar="NAME", default="", help="of the recorded graph"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="default: BAG_constraints.png"
    )
    options = parser.parse_args(arguments)
    if options.out and options.out.suffix != ".png":
        parser.error(f"--out {options.out}: the name of a plot ends in .png")
    from slot_lab.bags.bag import Bag  # noqa: PLC0415 - heavy
    from slot_lab.report.constraint_map import (  # noqa: PLC0415
        beside,
        draw_map,
        read_map,
        summary_lines,
    )

    try:
        found = read_map(Bag(options.bag, options.namespace))
        draw_map(found, out := options.out or beside(options.bag.resolve()))
    except (InputError, OSError) as error:
        refuse(parser.prog, error)
        return 2
    if not show(parser.prog, [*summary_lines(found), str(out)]):
        return 2
    return 1 if found.violated.any() else 0


if __name__ == "__main__":
    sys.exit(main())
