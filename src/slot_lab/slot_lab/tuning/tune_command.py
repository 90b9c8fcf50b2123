"""Searches a stride on the simulated robot, identifies it and writes its file.

The stages, in this order (default: all):

    forward   search of the forward pattern; the lateral one is its reflection
    turn      search of the pattern that turns in place
    steering  change of the patterns that alters the yaw rate alone
    identify  speeds, normal forces and sway of every pattern

An interrupted search continues when the same command is given again.

scripts/tune leg makes leg map and strides for another leg; it has a --help of its own.
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
GAITS = ("walk", "crawl")  # that `tune leg` makes, within 10 minutes
LEG = """Makes the leg map and the strides for the leg of a robot.yaml.

DIR gets what it lacks of config/, then leg_map.csv, and each stride: a short search of its patterns
from those that are there, its steering, its speeds, loads and sway on these legs, and a cruise speed
that it reaches. SLOT_CONFIG=DIR scripts/run takes it.

What is made for the robot already stays, so that the same command continues after an interrupt.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/tune`; returns the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] == ["leg"]:
        return _tune_leg(words[1:])
    parser, options = parse(words)
    from slot_lab.tuning.tune import run  # noqa: PLC0415 - heavy

    return run_command(parser, options, run, resumable=True)


def parse(
    words: Sequence[str],
) -> tuple[argparse.ArgumentParser, argparse.Namespace]:
    """Parser of `scripts/tune NAME`, and the options that words give."""
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
    return parser, options


def _tune_leg(words: Sequence[str]) -> int:
    """Command line of `scripts/tune leg`; returns the exit code."""
    parser = command_parser("tune leg", LEG)
    add = parser.add_argument
    add(
        "directory",
        nargs="?",
        type=Path,
        metavar="DIR",
        help="with your robot.yaml (default: config/)",
    )
    add(
        "--gaits",
        nargs="+",
        metavar="NAME",
        default=GAITS,
        help=f"strides (default: {' '.join(GAITS)})",
    )
    add(
        "--evaluations",
        type=positive_integer,
        default=160,
        metavar="N",
        help="candidates of a search (default: %(default)s)",
    )
    add_worker_options(parser)
    options = parser.parse_args(words)
    options.parse = lambda words: parse(words)[1]
    from slot_lab.tuning.tune_leg import run  # noqa: PLC0415 - heavy

    return run_command(parser, options, run, resumable=True)


def _stage(text: str) -> str:
    if text not in STAGES:
        raise argparse.ArgumentTypeError(
            f"{quoted(text)}: expected one of {', '.join(STAGES)}"
        )
    return text


if __name__ == "__main__":
    sys.exit(main())
