"""Predicts the motion of recorded tendon angles on the simulated robot and compares it.

RECORDING is a bag, or a CSV file with the header time,FL,FR,RL,RR,x,y,z,roll,pitch,yaw (s, rad, m).
Of a bag measured angles (/joint_states) are taken if recorded, else the commands through the model
of the servo; the motion from the ground truth if recorded, else /odom, else /mpc_state. With --fit,
parameters of the model are fitted to the first strides and judged on the others. An interrupted fit
continues when the same command is given again.
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import (
    INTERRUPTED,
    command_parser,
    positive_integer,
    show,
    within,
)
from slot_core.progress import ProgressLine
from slot_lab.bags.topics import COMMANDED, MEASURED, MOTION_TOPICS
from slot_lab.verdict import EXIT_CODES


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/twin`; returns the exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    from slot_lab.twin.twin import ERRORS, run  # noqa: PLC0415 - heavy

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with ProgressLine(parser.prog) as progress:
            lines, verdict = run(options, progress)
    except KeyboardInterrupt:
        print(
            "\nscripts/twin: interrupted; the same command continues", file=sys.stderr
        )
        return INTERRUPTED
    except ModuleNotFoundError as error:
        parser.error(f"{error}: run scripts/setup --bench, or give --workers 1")
    except ERRORS as error:
        parser.error(str(error))
    return verdict.code if show(parser.prog, [*lines, verdict.line]) else 2


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("twin", f"{__doc__}\n{EXIT_CODES}")
    add = parser.add_argument
    add("recording", type=Path, metavar="RECORDING", help="bag, or CSV file")
    add(
        "--scene",
        default="flat",
        metavar="NAME",
        help="scene of config/scene (default: flat)",
    )
    add(
        "--parameters",
        default="",
        metavar="NAME",
        help="set of config/parameters in that scene",
    )
    angles = "tendon angles that are simulated; of a CSV file, what they are"
    add("--angles", default="", choices=[MEASURED, COMMANDED], help=angles)
    add("--motion", default="", choices=MOTION_TOPICS, help="motion that is compared")
    add("--namespace", metavar="NAME", default="", help="of the recorded graph")
    length = "length of a stride (default: the gait's)"
    add("--period", type=within(0.05, 60.0, "s"), metavar="S", help=length)
    add("--fit", default="", metavar="NAME,...", help="parameters to fit")
    add(
        "--set",
        default="",
        metavar="NAME",
        help="write the fit as config/parameters/NAME.yaml",
    )
    add("--note", default="", metavar="TEXT", help="text for that file")
    starts = "starts of the fit (default: 1)"
    add("--starts", type=positive_integer, default=1, metavar="N", help=starts)
    add("--out", type=Path, metavar="DIR", help="default: results/twin/RECORDING")
    add(
        "--scheduler",
        default="",
        metavar="ADDRESS",
        help="of dask; default: this machine",
    )
    add(
        "--workers",
        type=positive_integer,
        metavar="N",
        help="local processes (default: cores)",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
