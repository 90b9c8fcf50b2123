"""Replays a bag through the cores, without ROS, and compares their outputs with the recorded ones.

Each replayed stage gets the recorded input of its node, so the first difference names the stage
that has changed: `/odom` and `/imu` go to the state estimator, recorded states to the gait
scheduler, with the commands that its previews name, recorded states and previews to the MPC, and
recorded forces, previews and states to the force map. A stage whose input or output the bag does
not hold is left out. The MPC's profile and the path that was followed are those that the bag names.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from slot_core import config
from slot_core.clock import SECOND
from slot_core.control.controller import command_for
from slot_core.estimation.state_estimator import (
    NEVER,
    Estimate,
    StateEstimator,
    Validity,
    read_estimator,
)
from slot_core.gait.gait import GaitPreview, read_gaits
from slot_core.gait.gait_scheduler import GaitScheduler
from slot_core.gait.route import KEPT, read_path
from slot_core.gait.route import Path as FollowedPath
from slot_core.messages import decode
from slot_core.mpc.force_map import make_force_map, read_force_map, read_springs
from slot_core.mpc.mpc import Mpc, MpcResult, read_mpc
from slot_core.recording.origin import FILES
from slot_core.robot import Array, read_robot
from slot_lab.bags.bag import Bag, BagError

ODOMETRY = "/odom"
SENSORS = (ODOMETRY, "/imu")
PATH = FILES["path"]

Fields = dict[str, Any]
"""Values by the name of the message's field."""

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
            f"{self.topic} at {self.stamp * 1e-9:.6f} s: {self.field} "
            f"recorded {self.recorded!r}, replayed {self.replayed!r}"
        )


@dataclass(frozen=True)
class Comparison:
    """Result of comparing recorded and replayed messages of one topic."""

    topic: str
    compared: int = 0
    largest: float = 0.0  # largest difference of any field
    first: Difference | None = None  # beyond the tolerance
    missing: tuple[str, ...] = ()  # topics that the bag lacks for the comparison

    def __str__(self) -> str:
        if self.missing:
            return f"{self.topic:<25}    - left out: the bag holds no {', '.join(self.missing)}"
        return f"{self.topic:<25}{self.compared:5d} compared, largest difference {self.largest:.1e}"


NEEDS = {
    "/mpc_state": (ODOMETRY,),
    "/gait_preview": ("/mpc_state",),
    "/ground_reaction_forces": ("/mpc_state", "/gait_preview"),
    "/desired_joint_angles": ("/mpc_state", "/gait_preview", "/ground_reaction_forces"),
}
"""Inputs by the output of each stage, in the order of the graph."""


def replay(bag: Bag, tolerance: float) -> list[Comparison]:
    """Compare every stage of the bag, in the order of the graph.

    Raises BagError if it holds no stage with its input, ConfigError if the configuration is
    invalid.
    """
    recorded = _Recorded(bag)
    replayed: dict[str, Callable[[_Recorded], dict[int, Fields]]] = {
        "/mpc_state": _estimates,
        "/gait_preview": _previews,
        "/ground_reaction_forces": _solves,
        "/desired_joint_angles": _angles,
    }
    comparisons = []
    for topic, inputs in NEEDS.items():
        missing = tuple(name for name in (topic, *inputs) if not bag.counts.get(name))
        if topic == "/gait_preview" and recorded.lost_path:
            missing = (*missing, recorded.lost_path)
        comparisons.append(
            Comparison(topic, missing=missing)
            if missing
            else compare(recorded, topic, replayed[topic](recorded), tolerance)
        )
    if all(comparison.missing for comparison in comparisons):
        raise BagError(f"{bag.path}: holds no stage together with its input")
    return comparisons


class _Recorded:
    """What a bag holds of the stages, read once."""

    def __init__(self, bag: Bag) -> None:
        self.bag, self.origin, self.robot = bag, bag.origin, read_robot()
        self.sensors: list[tuple[str, Any]] = []  # topic and message
        self.messages: dict[str, list[Any]] = {topic: [] for topic in NEEDS}
        topics = [t for t in (*SENSORS, *NEEDS) if bag.counts.get(t)]
        for topic, _, message in bag.merged(*topics) if topics else ():
            if topic in NEEDS:
                self.messages[topic].append(message)
            else:
                self.sensors.append((topic, message))

    @cached_property
    def states(self) -> dict[int, tuple[int, Array, int, int]]:
        """(stamp, state, validity, lead) by stamp."""
        return self._by_stamp("/mpc_state", lambda m: (*decode.state(m), decode.lead(m)))

    @cached_property
    def previews(self) -> dict[int, GaitPreview]:
        """Gait previews by stamp."""
        return self._by_stamp("/gait_preview", decode.preview)

    @cached_property
    def forces(self) -> dict[int, tuple[int, Array, int]]:
        """(stamp, force, status) by stamp."""
        return self._by_stamp("/ground_reaction_forces", decode.forces)

    def _by_stamp(self, topic: str, convert: Callable[[Any], Any]) -> dict[int, Any]:
        return {decode.stamp(m): convert(m) for m in self.messages[topic]}

    @property
    def profile(self) -> str:
        """Profile of the MPC; `default` if the bag does not name one."""
        return self.origin.about.get("mpc", "default")

    @property
    def path(self) -> FollowedPath | None:
        """The path that was followed, at the speed of the recorded commands; None without one."""
        if PATH not in self.origin.files:
            return None
        with TemporaryDirectory() as scratch:
            file = Path(scratch, PATH)
            file.write_bytes(self.origin.files[PATH])
            return read_path(file, self.origin.about.get("path_heading", KEPT))

    @property
    def lost_path(self) -> str:
        """Path that was followed but is not in the bag, as of `ros2 bag record`; else ""."""
        return "" if PATH in self.origin.files else self.origin.about.get("path", "")


def compare(
    recorded: _Recorded, topic: str, replayed: Mapping[int, Fields], tolerance: float
) -> Comparison:
    """Compare the recorded messages of a topic with replayed fields by stamp (ns).

    The end of a recording may hold an output without its input, so messages after the last replayed
    stamp are skipped. Raises BagError if no message is left to compare.
    """
    compared, largest, first, end = 0, 0.0, None, max(replayed, default=0)
    for message in recorded.messages[topic]:
        stamp = decode.stamp(message)
        if stamp > end:
            continue
        fields = replayed.get(stamp)
        if fields is None:
            first = first or Difference(topic, stamp, "header.stamp", 1.0, math.nan)
            continue
        compared += 1
        for name, value in fields.items():
            then, now = _numbers(getattr(message, name)), np.ravel(value)
            if np.array_equal(then, now):
                continue
            distance = _distance(then, now)
            largest = max(largest, float(distance.max(initial=0.0)))
            if first is None and (distance > tolerance).any():
                at = int(np.argmax(distance > tolerance))
                place = f"{name}[{at}]" if len(then) > 1 else name
                first = Difference(topic, stamp, place, float(then[at]), float(now[at]))
    if not compared and first is None:
        raise BagError(f"{recorded.bag.path}: holds no {topic} together with its input")
    return Comparison(topic, compared, largest, first)


def _estimates(recorded: _Recorded) -> dict[int, Fields]:
    """State estimates, as fields of MpcState, from the recorded odometry and IMU.

    Readings that the node refuses are left out.
    """
    settings = read_estimator()
    estimator = StateEstimator(settings)
    delay = round(settings.timing.command_delay * SECOND)
    fields = {}
    for topic, message in _as_they_arrived(recorded, delay):
        with suppress(ValueError):
            if topic == ODOMETRY:
                estimator.add_odometry(*decode.torso_odometry(message))
            else:
                estimator.add_imu(*decode.imu(message))
        while (estimate := estimator.poll()) is not None:
            fields[estimate.stamp] = _state_fields(estimate)
    return fields


def _as_they_arrived(recorded: _Recorded, delay: int) -> Iterator[tuple[str, Any]]:
    """Sensor readings in the order in which the estimator got them, as (topic, message).

    The recorder may have received odometry and IMU in another order. A recorded state tells the
    newest IMU sample it was predicted with, at header.stamp + lead - `delay` (ns), and its odometry
    follows that sample. Other readings keep their order. Odometry before that of a first state
    that is initialising is left out: the estimator did not listen yet.
    """
    first = next(iter(recorded.states.values()), None)
    begin = first[0] if first is not None and first[2] == Validity.INITIALISING else NEVER
    imu = {decode.stamp(message) for topic, message in recorded.sensors if topic != ODOMETRY}
    place: dict[int, int] = {}  # stamp of the odometry: that of the IMU sample before it
    for stamp, _, validity, lead in recorded.states.values():
        if validity != Validity.ODOMETRY_LOST and stamp + lead - delay in imu:
            place[stamp] = stamp + lead - delay
    after: dict[int, list[Any]] = {}
    for topic, message in recorded.sensors:
        if topic == ODOMETRY and decode.stamp(message) in place:
            after.setdefault(place[decode.stamp(message)], []).append(message)
    for topic, message in recorded.sensors:
        stamp = decode.stamp(message)
        if topic != ODOMETRY:
            yield topic, message
            yield from ((ODOMETRY, late) for late in after.pop(stamp, ()))
        elif stamp not in place and stamp >= begin:
            yield topic, message


def _state_fields(estimate: Estimate) -> Fields:
    x = estimate.state
    return {
        "rpy": x[0:3],
        "position": x[3:6],
        "angular_velocity": x[6:9],
        "linear_velocity": x[9:12],
        "covariance": estimate.covariance,
        "validity": int(estimate.validity),
    }


def _previews(recorded: _Recorded) -> dict[int, Fields]:
    """Gait previews, as fields of GaitPreview, from the recorded states and commands."""
    gaits, first = read_gaits(), next(iter(recorded.previews.values())).command
    scheduler = GaitScheduler(
        gaits, recorded.robot, read_springs(), first.gait, first.velocity, recorded.path
    )
    fields = {}
    for stamp, (_, state, _, lead) in recorded.states.items():
        if stamp in recorded.previews:
            scheduler.set_command(recorded.previews[stamp].command)
            fields[stamp] = _preview_fields(scheduler.step(stamp + lead, state))
    return fields


def _preview_fields(preview: GaitPreview) -> Fields:
    names = ("phase", "period", "dt", "contact", "friction", "normal_force", "tendon_angle")
    return {name: getattr(preview, name) for name in (*names, "reference", "posture")}


def _solves(recorded: _Recorded) -> dict[int, Fields]:
    """Results of the MPC, as fields of GroundReactionForces, in the order of the states.

    The MPC keeps state between cycles. A state that the recorded controller skipped, because no
    forces have its stamp, is therefore skipped again.
    """
    settings = config.replace(read_mpc(recorded.profile), {"acceptance.time_budget": math.inf})
    mpc = Mpc(recorded.robot, settings, timer=lambda: 0.0)
    return {
        stamp: _forces_fields(mpc.step(state, recorded.previews[stamp]))
        for stamp, (_, state, *_) in recorded.states.items()
        if stamp in recorded.previews and stamp in recorded.forces
    }


def _forces_fields(result: MpcResult) -> Fields:
    names = [field.name for field in dataclasses.fields(result)]
    return {
        n: getattr(result, n) for n in names if n not in ("message", "solve_time", "status")
    } | {"status": int(result.status)}


def _angles(recorded: _Recorded) -> dict[int, Fields]:
    """Tendon angles and their rates, as fields of JointState."""
    states, previews = recorded.states, recorded.previews
    name = read_mpc(recorded.profile).map
    force_map = make_force_map(recorded.robot, read_force_map(), name)

    has_rates = all(len(m.velocity) for m in recorded.messages["/desired_joint_angles"])

    def fields(stamp: int, force: Any, status: int) -> Fields:
        nominal = force_map.nominal(previews[stamp], states[stamp][1])
        command = command_for(force_map, force, status, previews[stamp], nominal)
        return {"position": command.angle} | ({"velocity": command.rate} if has_rates else {})

    return {
        stamp: fields(stamp, force, status)
        for stamp, (_, force, status) in recorded.forces.items()
        if stamp in previews and stamp in states
    }


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
        raise argparse.ArgumentTypeError(f"{text!r}: expected OLD:=NEW, names of topics")
    return old, new


def add_bag_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bag, its namespace and the new names of its topics."""
    parser.add_argument("bag", type=Path, help="directory of the bag, or one .mcap or .db3 file")
    parser.add_argument("--namespace", default="", help="of the recorded graph")
    parser.add_argument(
        "--remap", type=_renaming, action="append", default=[], metavar="OLD:=NEW",
        help="read the bag's topic OLD as NEW, for example /camera/odom:=/odom; may be repeated",
    )  # fmt: skip


def open_bag(options: argparse.Namespace) -> Bag:
    """The bag of these arguments; raises BagError."""
    return Bag(options.bag, options.namespace, dict(options.remap))


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/replay`; exit code 0: equal, 1: a difference, 2: no replay."""
    parser = argparse.ArgumentParser(
        prog="scripts/replay",
        description=__doc__.split("\n\n")[0],
        epilog="With --live it plays the sensors into running nodes: scripts/replay --live --help",
    )
    add_bag_arguments(parser)
    parser.add_argument(
        "--tolerance", type=_tolerance, default=TOLERANCE, help="in SI units (default: %(default)g)"
    )
    parser.add_argument(
        "--mend", type=Path, metavar="NEW", help="only write what is left as a new, whole bag NEW"
    )
    options = parser.parse_args(arguments)
    try:
        bag = open_bag(options)
        if options.mend:
            bag.save(options.mend)
            return 0
        comparisons = replay(bag, options.tolerance)
    except (BagError, config.ConfigError) as error:
        print(f"scripts/replay: {error}", file=sys.stderr)
        return 2
    except ValueError as error:  # a recorded message that its node has rejected
        print(f"scripts/replay: {options.bag}: cannot be replayed: {error}", file=sys.stderr)
        return 2
    differences = [c.first for c in comparisons if c.first is not None]
    lines = [*bag.lines(), *map(str, comparisons)]
    lines += [f"first difference: {differences[0]}"] if differences else []
    try:
        print("\n".join(lines), flush=True)
    except OSError as error:  # a full disk, a closed pipe
        print(f"scripts/replay: output: {error.strerror}", file=sys.stderr)
        # What is left in the buffer must not fail again at the end of the process.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 2
    return 1 if differences else 0


if __name__ == "__main__":
    gc.disable()  # all messages are kept to the end: collections would take a tenth of the time
    sys.exit(main())
