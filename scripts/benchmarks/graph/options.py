"""Options of the benchmark."""

import argparse

from benchmarks import against
from slot_core.command_line import within


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    parser.add_argument(
        "--endurance",
        type=within(0.0, 1e6, "s"),
        metavar="S",
        help="graph time of the long walk in lockstep, s; 0: none (default: an hour, quick: none)",
    )
    against.options(parser)
