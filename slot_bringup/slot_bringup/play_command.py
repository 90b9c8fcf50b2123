"""Plays the sensors of a bag into running nodes, in their recorded order and pace, with /clock.

The graph has to run without a robot: `scripts/run --hardware none`, or the launch file with
`hardware:=none`. The nodes then follow the clock of the bag. The stages before the one of interest
may run or not: each answers what it gets.
"""

import sys
from collections.abc import Sequence

from slot_core.command_line import CommandParser, refuse, within
from slot_core.refusal import InputError
from slot_lab.bags.replay_command import add_bag_arguments

PROGRAM = "scripts/replay"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/replay --live`; exit code 0: played, 1: interrupted, 2: refused."""
    parser = CommandParser(prog=PROGRAM, description=__doc__)
    add = parser.add_argument
    add("--live", action="store_true", help="play into running nodes")
    add_bag_arguments(parser)
    add(
        "--rate",
        type=within(0.01, 100.0),
        default=1.0,
        help="of the clock (default: %(default)g)",
    )
    add(
        "--start",
        type=within(0.0, 1e6, "s"),
        default=0.0,
        metavar="S",
        help="leave out S seconds",
    )
    options = parser.parse_args(arguments)
    try:
        from slot_bringup.play import play_bag  # noqa: PLC0415 - heavy

        return 0 if play_bag(options, PROGRAM) else 2
    except InputError as error:
        refuse(PROGRAM, error)
        return 2
    except KeyboardInterrupt:
        return 1


if __name__ == "__main__":
    sys.exit(main())
