"""Searches a stride on the simulated robot, identifies it and writes its file.

The stages, in this order (default: all):

    forward   search of the forward pattern; the lateral one is its reflection
    turn      search of the pattern that turns in place
    steering  change of the patterns that alters the yaw rate alone
    identify  speeds, normal forces and sway of every pattern

An interrupted search continues when the same command is given again.
"""

import argparse
import math
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import command_parser, positive_integer
from slot_core.refusal import quoted
from slot_lab.desk_command import run_command
from slot_lab.workers import add_worker_options

STAGES = ("forward", "turn", "steering", "identify")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/tune`; returns the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    parser = command_parser("tune", __doc__)
    add = parser.add_argument
    add("gait", metavar="NAME", help="name of the stride that is written")
    add(
        "stages",
        nargs="*",
        metavar="STAGE",
        type=_stage,
        help=", ".join(STAGES),
    )
    add(
        "--like",
        metavar="NAME",
        help="stride to start from (default: the same)",
    )
    add(
        "--scratch",
        action="store_true",
        help="start the searches from a random pattern",
    )
    add(
        "--out",
        type=Path,
        metavar="FILE",
        help="default: config/gait/NAME.yaml",
    )
    add(
        "--seed",
        metavar="N",
        type=positive_integer,
        default=1,
        help="seed of the searches (default: 1)",
    )
    add("--evaluations", type=int, metavar="N", help="candidates of a search")
    add(
        "--friction",
        type=float,
        nargs="+",
        metavar="N",
        help="friction of the floors",
    )
    add("--tilt", type=float, metavar="DEG", help="tilt RMS that costs nothing")
    add(
        "--top",
        type=float,
        default=math.inf,
        metavar="M",
        help="height the torso stays below",
    )
    add("--height", type=float, metavar="M", help="height of base_link")
    add(
        "--height-range",
        type=float,
        nargs=2,
        metavar="M",
        help="heights that can be commanded",
    )
    add("--period", type=float, metavar="S", help="duration of a stride")
    add(
        "--cruise",
        type=float,
        metavar="M/S",
        help="v_x if none is requested, m/s",
    )
    add(
        "--scene",
        metavar="NAME",
        help="scene of config/scene; map is three times as fast",
    )
    add_worker_options(parser)
    add(
        "--quick",
        action="store_true",
        help="one floor, 32 candidates: a demonstration",
    )
    options = parser.parse_args(words)
    options.stages = [
        stage for stage in STAGES if stage in (options.stages or STAGES)
    ]
    options.command = f"scripts/tune {shlex.join(words)}"
    from slot_lab.tuning.tune import run  # noqa: PLC0415 - heavy

    return run_command(parser, options, run, resumable=True)


def _stage(text: str) -> str:
    if text not in STAGES:
        raise argparse.ArgumentTypeError(
            f"{quoted(text)}: expected one of {', '.join(STAGES)}"
        )
    return text


if __name__ == "__main__":
    sys.exit(main())
