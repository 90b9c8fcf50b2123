"""Predicts the motion of recorded tendon angles on the simulated robot and compares it.

RECORDING is a bag, or a CSV file with the header time,FL,FR,RL,RR,x,y,z,roll,pitch,yaw (s, rad, m).
Of a bag measured angles (/joint_states) are taken if recorded, else the commands through the model
of the servo; the motion from the ground truth if recorded, else /odom, else /mpc_state. With --fit,
parameters of the model are fitted to the first strides and judged on the others. An interrupted fit
continues when the same command is given again.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import command_parser, positive_integer, within
from slot_lab.bags.replay_command import add_remap
from slot_lab.bags.topics import COMMANDED, MEASURED, MOTION_TOPICS
from slot_lab.desk_command import run_command
from slot_lab.verdict import EXIT_CODES
from slot_lab.workers import add_worker_options


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/twin`; returns the exit code."""
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
    add(
        "--angles",
        default="",
        choices=[MEASURED, COMMANDED],
        help="tendon angles that are simulated; of a CSV file, what they are",
    )
    add(
        "--motion",
        default="",
        choices=MOTION_TOPICS,
        help="motion that is compared",
    )
    add("--namespace", metavar="NAME", default="", help="of the recorded graph")
    add_remap(parser)
    add(
        "--period",
        type=within(0.05, 60.0, "s"),
        metavar="S",
        help="length of a stride (default: the gait's)",
    )
    add("--fit", default="", metavar="NAME,...", help="parameters to fit")
    add(
        "--set",
        default="",
        metavar="NAME",
        help="write the fit as config/parameters/NAME.yaml",
    )
    add("--note", default="", metavar="TEXT", help="text for that file")
    add(
        "--starts",
        type=positive_integer,
        default=1,
        metavar="N",
        help="starts of the fit (default: 1)",
    )
    add(
        "--out",
        type=Path,
        metavar="DIR",
        help="default: results/twin/RECORDING",
    )
    add_worker_options(parser)
    options = parser.parse_args(arguments)
    from slot_lab.twin.twin import run  # noqa: PLC0415 - heavy

    return run_command(parser, options, run, resumable=True)


if __name__ == "__main__":
    sys.exit(main())
