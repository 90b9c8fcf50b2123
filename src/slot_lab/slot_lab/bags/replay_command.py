"""Replays a bag: runs the controller on the recorded sensor data and compares its outputs.

No ROS is needed. Each replayed stage gets the recorded input of its node, so the first difference
names the stage that has changed: `/odom`, `/imu` and `/joint_states` go to the state estimator,
recorded states to the gait scheduler, with the commands that its previews name, recorded states and
previews to the policy, and recorded plans, previews and states to the force map. A stage whose
input or output the bag does not hold is left out. A bag that begins mid-run, such as a later file
of a split one, is compared from its first key frame on: the nodes record their complete state every
few seconds, and the state estimator the order in which it has taken its readings
(slot_msgs/msg/StageRecord). Of a bag without these the state estimator is left out and, if it
begins mid-run, all but the force map. The policy and the path that was followed are those that the
bag names.
"""

import argparse
import gc
import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import CommandParser, ProgressLine, within
from slot_core.refusal import InputError, quoted
from slot_lab.bags.topics import OUTPUTS
from slot_lab.desk_command import Outcome, run_command

TOLERANCE = 1e-6
"""Default of the largest difference, in the field's SI unit. Equal versions give none, on every
processor; it leaves room for a change that is to change roundoff alone."""


def _renaming(text: str) -> tuple[str, str]:
    old, separator, new = text.partition(":=")
    if not (separator and old.strip("/") and new.strip("/")):
        raise argparse.ArgumentTypeError(
            f"{quoted(text)}: expected OLD:=NEW, names of topics"
        )
    return old, new


def add_bag_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bag, its namespace and the new names of its topics."""
    add = parser.add_argument
    add(
        "bag",
        type=Path,
        metavar="BAG",
        help="directory of the bag, or one .mcap or .db3 file",
    )
    add("--namespace", default="", metavar="NAME", help="of the recorded graph")
    add_remap(parser)


def add_remap(
    parser: argparse.ArgumentParser, option: str = "--remap", whose: str = ""
) -> None:
    """Add the option of new names of a bag's topics, a list of pairs."""
    parser.add_argument(
        option,
        type=_renaming,
        action="append",
        default=[],
        metavar="OLD:=NEW",
        help=f"read the {whose}bag's topic OLD as NEW, for example /camera/odom:=/odom; may be"
        " repeated",
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/replay`; exit code 0: equal, 1: a difference, 2: no replay."""
    parser = CommandParser(
        prog="scripts/replay",
        description=__doc__.split("\n\n")[0],
        epilog="With --live it plays the sensors into running nodes: scripts/replay --live --help",
    )
    add_bag_arguments(parser)
    add = parser.add_argument
    add(
        "--tolerance",
        type=within(0.0, 1e6),
        default=TOLERANCE,
        metavar="N",
        help="largest difference, in SI units (default: %(default)g)",
    )
    add(
        "--policy",
        default="",
        metavar="FILE",
        help="file of the policy, if it is a user's, or onnx:FILE",
    )
    some = parser.add_mutually_exclusive_group()
    for name, text in (
        ("--skip", "leave out"),
        ("--only", "compare nothing but"),
    ):
        some.add_argument(
            name,
            choices=list(OUTPUTS.values()),
            action="append",
            default=[],
            help=f"{text} this stage; may be repeated",
        )
    add(
        "--mend",
        type=Path,
        metavar="DIR",
        help="only write what is left of it as a new bag in DIR",
    )
    return run_command(parser, parser.parse_args(arguments), _replay)


def _replay(options: argparse.Namespace, progress: ProgressLine) -> Outcome:
    """Replay a bag, or mend it; raises BagError, ConfigError."""
    from slot_lab.bags.bag import Bag, BagError  # noqa: PLC0415 - heavy
    from slot_lab.bags.check_bag import check_bag  # noqa: PLC0415

    bag = Bag(options.bag, options.namespace, dict(options.remap))
    if options.mend:
        bag.save(options.mend)
        left_out = [
            f"without {t}, which {why}" for t, why in bag.foreign.items()
        ]
        return [f"wrote {options.mend}", *left_out], 0
    chosen = options.only, options.skip
    try:
        comparisons = check_bag(
            bag, options.tolerance, options.policy, *chosen, tell=progress
        )
    except InputError:
        raise
    except ValueError as error:  # a recorded message that its node has rejected
        raise BagError(f"{options.bag}: cannot be replayed: {error}") from None
    differences = [c.first for c in comparisons if c.first is not None]
    lines = [*bag.lines(), *map(str, comparisons)]
    lines += [f"first difference: {found}" for found in differences[:1]]
    return lines, 1 if differences else 0


if __name__ == "__main__":
    gc.disable()  # all messages are kept to the end: collections would take a tenth of the time
    sys.exit(main())
