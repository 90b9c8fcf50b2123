"""Comparison of the messages of a bag with those that the stages give of its inputs."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slot_core.clock import to_seconds
from slot_core.command_line import untold
from slot_core.messages import decode
from slot_lab.bags.bag import Bag, BagError, plain
from slot_lab.bags.replayed_stages import STAGES, RecordedStages, Replayed
from slot_lab.bags.topics import COMMANDED, ESTIMATE, OUTPUTS, SENSORS

LACKING = "the bag holds no"
MID_RUN = "the bag begins mid-run, after what the state depends on"


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
    why: str = ""  # nothing was compared
    compared: int = 0
    largest: float = 0.0  # largest difference of any field
    first: Difference | None = None  # beyond the tolerance
    # ns, stamp of the first message compared; 0: the bag's first
    begin: int = 0
    gaps: int = 0  # later messages whose inputs the bag lacks
    lost: str = ""  # the first of these inputs
    nodes: Sequence[str] = ()  # of a user, which published the topic

    def __str__(self) -> str:
        if self.why:
            return f"{self.topic:<25}    - left out: {self.why}"
        line = f"{self.topic:<25}{self.compared:5d} compared, largest difference {self.largest:.1e}"
        if self.begin:
            line += f", from {to_seconds(self.begin):.3f} s on"
        if self.gaps:
            line += f"; {self.gaps} are not" + (
                f": {self.lost}" if self.lost else ""
            )
        return line + (
            f"; published by {', '.join(self.nodes)}" if self.nodes else ""
        )


def check_bag(
    bag: Bag,
    tolerance: float,
    own_policy: str = "",
    only: Collection[str] = (),
    skip: Collection[str] = (),
    *,
    tell: Callable[[str], object] = untold,
) -> list[StageComparison]:
    """Compare every stage of the bag, in the order of the graph.

    own_policy: file of a user's policy, as `RecordedStages` takes it. only: nodes of the stages to
    compare; none: all but those to `skip`, and those whose output a user's node has published.
    tell: takes the topic that is replayed.
    Raises BagError if no stage can be compared, ConfigError if the configuration is invalid.
    """
    recorded = RecordedStages(bag, own_policy)
    comparisons = []
    for topic, stage in STAGES.items():
        tell(topic)
        if why := _reason(recorded, topic, only, skip):
            comparisons.append(StageComparison(topic, why))
        else:
            comparisons.append(
                compare(recorded, topic, stage.replay(recorded), tolerance)
            )
    if all(c.why.startswith(LACKING) for c in comparisons):
        raise BagError(f"{bag.path}: holds no stage together with its input")
    if all(c.why for c in comparisons):
        why = next(c.why for c in comparisons if not c.why.startswith(LACKING))
        raise BagError(f"{bag.path}: {why}; no stage can be compared")
    return comparisons


def _reason(
    recorded: RecordedStages,
    topic: str,
    only: Collection[str],
    skip: Collection[str],
) -> str:
    """Reason why a stage is not compared; else empty."""
    inputs = [topic, *STAGES[topic].inputs]
    if topic == ESTIMATE:
        inputs += [name for name in SENSORS if name in recorded.taken]
    lacking = [name for name in inputs if not recorded.bag.counts.get(name)]
    if topic == "/gait_preview" and recorded.lost_path:
        lacking.append(recorded.lost_path)
    if lacking:
        return f"{LACKING} {', '.join(lacking)}"
    node = OUTPUTS[topic]
    if node in skip or (only and node not in only):
        return f"--{'only' if only else 'skip'} {' '.join(only or skip)}"
    if not only and (others := recorded.own_nodes(topic)):
        return f"published by {', '.join(others)}, not by our {node}"
    # all but the force map depend on everything that came before
    if topic != COMMANDED and recorded.begins_mid_run:
        return MID_RUN
    # node may have published it
    another = not only and any(recorded.records.values())
    if not recorded.records[node] and (another or topic == ESTIMATE):
        return f"no record of {node} in the bag"
    return ""


def compare(
    recorded: RecordedStages, topic: str, replayed: Replayed, tolerance: float
) -> StageComparison:
    """Compare the recorded messages of a topic with the replayed ones.

    The end of a recording may hold an output without its input, so messages after the last replayed
    stamp are skipped, and so are those that the bag does not tell enough for. If no message is left
    the stage is left out.
    """
    compared, largest, first, end = (
        0,
        0.0,
        None,
        max(replayed.fields, default=0),
    )
    skipped, begin, gaps = 0, 0, 0
    for message in recorded.messages[topic]:
        stamp = decode.stamp(message)
        if stamp in replayed.unknown:
            skipped += 1
            continue
        if stamp > end:
            continue
        if not compared:
            begin, skipped = stamp if skipped else 0, 0
        fields = replayed.fields.get(stamp)
        if fields is None:
            first = first or Difference(
                topic, stamp, "header.stamp", 1.0, math.nan
            )
            continue
        gaps, skipped = gaps + skipped, 0
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
                    float(array[at]) if at < len(array) else math.nan
                    for array in (then, now)
                )
                first = Difference(topic, stamp, place, *values)
    if not compared and first is None:
        if not replayed.unknown:
            raise BagError(
                f"{recorded.bag.path}: holds no {topic} together with its input"
            )
        return StageComparison(topic, MID_RUN)
    return StageComparison(
        topic,
        compared=compared,
        largest=largest,
        first=first,
        begin=begin,
        gaps=gaps,
        lost=replayed.lost,
        nodes=recorded.own_nodes(topic),
    )


def _numbers(value: Any) -> np.ndarray:
    """A message's field as a flat array: numbers, text, arrays, vectors and arrays of vectors."""
    if isinstance(value, str):
        value = list(value.encode())
    return np.array(plain(value), dtype=float).ravel()


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
