"""Replays a bag: runs the controller on the recorded sensor data and compares what it gives.

No ROS is needed. Each replayed stage gets the recorded input of its node, so the first difference
names the stage that has changed: `/odom` and `/imu` go to the state estimator, recorded states to
the gait scheduler, with the commands that its previews name, recorded states and previews to the
policy, and recorded plans, previews and states to the force map. A stage whose input or output the
bag does not hold is left out. Of a bag that begins mid-run, such as a later file of a split one, so
are the stages that depend on what came before: only the force map is compared. The policy and the
path that was followed are those that the bag names.
"""

from __future__ import annotations

import argparse
import gc
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slot_core import config
from slot_core.clock import to_seconds
from slot_core.command_line import CommandParser, refuse, show
from slot_core.messages import decode
from slot_core.refusal import quoted
from slot_lab.bags.bag import Bag, BagError
from slot_lab.bags.replayed_stages import REMEMBERING, STAGES, Fields, RecordedStages

MID_RUN = "the bag begins mid-run, after what the state depends on"
TOLERANCE = 1e-6
"""Default of the largest difference, in the field's SI unit. On another machine the order of
summation in linear algebra changes the states by 1e-12 and the forces by the solver's tolerance."""


@dataclass(frozen=True)
class Difference:
    """The first replayed value that differs from the recorded one."""

    topic: str
    stamp: int  # ns
    field: str
    recorded: float
    replayed: float

    def __str__(self) -> str:
        return (
            f"{self.topic} at {to_seconds(self.stamp):.6f} s: {self.field} "
            f"recorded {self.recorded!r}, replayed {self.replayed!r}"
        )


@dataclass(frozen=True)
class StageComparison:
    """Result of comparing recorded and replayed messages of one topic."""

    topic: str
    compared: int = 0
    largest: float = 0.0  # largest difference of any field
    first: Difference | None = None  # beyond the tolerance
    missing: tuple[str, ...] = ()  # topics that the bag lacks for the comparison
    unknown: bool = False  # whether the stage's state at the begin of the bag is not known

    @property
    def left_out(self) -> str:
        """Why nothing was compared; empty if it was."""
        lacking = f"the bag holds no {', '.join(self.missing)}" if self.missing else ""
        return lacking or (MID_RUN if self.unknown else "")

    def __str__(self) -> str:
        if self.left_out:
            return f"{self.topic:<25}    - left out: {self.left_out}"
        return f"{self.topic:<25}{self.compared:5d} compared, largest difference {self.largest:.1e}"


def check_bag(bag: Bag, tolerance: float, own_policy: str = "") -> list[StageComparison]:
    """Compare every stage of the bag, in the order of the graph.

    own_policy: file of a policy of one's own, as `RecordedStages` takes it. Raises BagError if no
    stage can be compared, ConfigError if the configuration is invalid.
    """
    recorded = RecordedStages(bag, own_policy)
    comparisons = []
    for topic, (replay, *inputs) in STAGES.items():
        missing = [name for name in (topic, *inputs) if not bag.counts.get(name)]
        if topic == "/gait_preview" and recorded.lost_path:
            missing.append(recorded.lost_path)
        unknown = not missing and topic in REMEMBERING and recorded.begins_mid_run
        found = StageComparison(topic, missing=tuple(missing), unknown=unknown)
        if not found.left_out:
            found = compare(recorded, topic, replay(recorded), tolerance)
        comparisons.append(found)
    if all(comparison.missing for comparison in comparisons):
        raise BagError(f"{bag.path}: holds no stage together with its input")
    if all(comparison.left_out for comparison in comparisons):
        raise BagError(f"{bag.path}: {MID_RUN}; no stage can be compared")
    return comparisons


def compare(
    recorded: RecordedStages, topic: str, replayed: Mapping[int, Fields], tolerance: float
) -> StageComparison:
    """Compare the recorded messages of a topic with replayed fields by stamp (ns).

    The end of a recording may hold an output without its input, so messages after the last replayed
    stamp are skipped, and so are those before the first one if the bag begins mid-run. Raises
    BagError if no message is left to compare.
    """
    compared, largest, first, end = 0, 0.0, None, max(replayed, default=0)
    begin = min(replayed, default=0) if recorded.begins_mid_run else 0
    for message in recorded.messages[topic]:
        stamp = decode.stamp(message)
        if not begin <= stamp <= end:
            continue
        fields = replayed.get(stamp)
        if fields is None:
            first = first or Difference(topic, stamp, "header.stamp", 1.0, math.nan)
            continue
        compared += 1
        for name, value in fields.items():
            if not hasattr(message, name):
                continue  # an older bag's
            then, now = _numbers(getattr(message, name)), np.ravel(value)
            if np.array_equal(then, now):
                continue
            distance = _distance(then, now)
            largest = max(largest, float(distance.max(initial=0.0)))
            if first is None and (distance > tolerance).any():
                at = int(np.argmax(distance > tolerance))
                place = f"{name}[{at}]" if len(then) > 1 else name
                values = (
                    float(array[at]) if at < len(array) else math.nan for array in (then, now)
                )
                first = Difference(topic, stamp, place, *values)
    if not compared and first is None:
        raise BagError(f"{recorded.bag.path}: holds no {topic} together with its input")
    return StageComparison(topic, compared, largest, first)


def _numbers(value: Any) -> np.ndarray:
    """A message's field as a flat array: numbers, arrays, vectors and arrays of vectors."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        return value.astype(float).ravel()
    if hasattr(value, "x"):
        return decode.vector(value)
    values = list(value) if isinstance(value, (Sequence, np.ndarray)) else [value]
    if values and hasattr(values[0], "x"):
        return np.concatenate([decode.vector(v) for v in values])
    return np.array(values, dtype=float)


def _distance(recorded: np.ndarray, replayed: np.ndarray) -> np.ndarray:
    """|recorded - replayed|; zero where both are equal or both NaN.

    Infinite where they differ and one is not finite, and where the shapes differ.
    """
    if recorded.shape != replayed.shape:
        return np.full(max(len(recorded), 1), math.inf)
    same = (recorded == replayed) | (np.isnan(recorded) & np.isnan(replayed))
    finite = np.isfinite(recorded) & np.isfinite(replayed)
    distance = np.where(same, 0.0, math.inf)
    distance[finite] = np.abs(recorded[finite] - replayed[finite])
    return distance


def _tolerance(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < math.inf:  # no difference exceeds NaN
        raise argparse.ArgumentTypeError(f"{text}: outside [0, inf)")
    return value


def _renaming(text: str) -> tuple[str, str]:
    old, separator, new = text.partition(":=")
    if not (separator and old.strip("/") and new.strip("/")):
        raise argparse.ArgumentTypeError(f"{quoted(text)}: expected OLD:=NEW, names of topics")
    return old, new


def add_bag_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bag, its namespace and the new names of its topics."""
    add = parser.add_argument
    place = "directory of the bag, or one .mcap or .db3 file"
    add("bag", type=Path, metavar="BAG", help=place)
    add("--namespace", default="", metavar="NAME", help="of the recorded graph")
    new = "read the bag's topic OLD as NEW, for example /camera/odom:=/odom; may be repeated"
    add("--remap", type=_renaming, action="append", default=[], metavar="OLD:=NEW", help=new)


def open_bag(options: argparse.Namespace) -> Bag:
    """The bag of these arguments; raises BagError."""
    return Bag(options.bag, options.namespace, dict(options.remap))


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/replay`; exit code 0: equal, 1: a difference, 2: no replay."""
    parser = CommandParser(
        prog="scripts/replay",
        description=__doc__.split("\n\n")[0],
        epilog="With --live it plays the sensors into running nodes: scripts/replay --live --help",
    )
    add_bag_arguments(parser)
    add, size = parser.add_argument, "largest difference, in SI units (default: %(default)g)"
    add("--tolerance", type=_tolerance, default=TOLERANCE, metavar="N", help=size)
    own = "file of the policy, if it is one of your own, or onnx:FILE"
    add("--policy", default="", metavar="FILE", help=own)
    left = "only write what is left of it as a new bag in DIR"
    add("--mend", type=Path, metavar="DIR", help=left)
    options = parser.parse_args(arguments)
    try:
        bag = open_bag(options)
        if options.mend:
            bag.save(options.mend)
            return 0
        comparisons = check_bag(bag, options.tolerance, options.policy)
    except (BagError, config.ConfigError) as error:
        refuse(parser.prog, error)
        return 2
    except ValueError as error:  # a recorded message that its node has rejected
        refuse(parser.prog, f"{options.bag}: cannot be replayed: {error}")
        return 2
    differences = [c.first for c in comparisons if c.first is not None]
    lines = [*bag.lines(), *map(str, comparisons)]
    lines += [f"first difference: {differences[0]}"] if differences else []
    if not show(parser.prog, lines):
        return 2
    return 1 if differences else 0


if __name__ == "__main__":
    gc.disable()  # all messages are kept to the end: collections would take a tenth of the time
    sys.exit(main())
