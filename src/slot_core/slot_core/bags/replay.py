"""Replays a bag through the cores, without ROS, and compares their outputs with the recorded ones.

Each replayed stage gets the recorded input of its node, so the first difference names the stage
that has changed: `/odom` and `/imu` go to the state estimator, recorded states and gait previews to
the MPC, recorded forces, previews and states to the force map. The gait scheduler gets the recorded
states and the commands that its previews name; a path that it followed is not recorded.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
import sys
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slot_core import config
from slot_core.bags import decode
from slot_core.bags.bag import Bag, BagError
from slot_core.control.controller import command_for
from slot_core.control.force_map import make_force_map, read_force_map, read_springs
from slot_core.control.gait import GaitPreview, read_gaits
from slot_core.control.gait_scheduler import GaitScheduler
from slot_core.control.mpc.mpc import Mpc, MpcResult, read_mpc
from slot_core.control.state_estimator import Estimate, StateEstimator, read_estimator
from slot_core.robot import Robot, read_robot

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
    compared: int
    largest: float  # largest difference of any field
    first: Difference | None  # beyond the tolerance


def replay(bag: Bag, tolerance: float) -> list[Comparison]:
    """Compare every stage of the bag, in the order of the graph.

    Raises BagError if the bag lacks a topic, ConfigError if the configuration is invalid.
    """
    robot = read_robot()
    states = _by_stamp(bag, "/mpc_state", lambda m: (*decode.state(m), decode.lead(m)))
    previews = _by_stamp(bag, "/gait_preview", decode.preview)
    forces = _by_stamp(bag, "/ground_reaction_forces", decode.forces)
    return [
        compare(bag, "/mpc_state", _estimates(bag), tolerance),
        compare(bag, "/gait_preview", _previews(robot, states, previews), tolerance),
        compare(
            bag, "/ground_reaction_forces", _solves(robot, states, previews, forces), tolerance
        ),
        compare(bag, "/desired_joint_angles", _angles(robot, forces, previews, states), tolerance),
    ]


def compare(bag: Bag, topic: str, replayed: Mapping[int, Fields], tolerance: float) -> Comparison:
    """Compare the recorded messages of a topic with replayed fields by stamp (ns).

    The end of a recording may hold an output without its input, so messages after the last replayed
    stamp are skipped. Raises BagError if no message is left to compare.
    """
    compared, largest, first = 0, 0.0, None
    for _, message in bag.messages(topic):
        stamp = decode.stamp(message)
        if stamp > max(replayed, default=0):
            continue
        fields = replayed.get(stamp)
        if fields is None:
            first = first or Difference(topic, stamp, "header.stamp", 1.0, math.nan)
            continue
        compared += 1
        for name, value in fields.items():
            recorded = _numbers(getattr(message, name))
            distance = _distance(recorded, np.ravel(value))
            largest = max(largest, float(distance.max(initial=0.0)))
            if first is None and (distance > tolerance).any():
                at = int(np.argmax(distance > tolerance))
                place = f"{name}[{at}]" if len(recorded) > 1 else name
                first = Difference(
                    topic, stamp, place, float(recorded[at]), float(np.ravel(value)[at])
                )
    if not compared and first is None:
        raise BagError(f"{bag.path}: holds no {topic} together with its input")
    return Comparison(topic, compared, largest, first)


def _by_stamp(bag: Bag, topic: str, convert: Callable[[Any], Any]) -> dict[int, Any]:
    """Decoded messages of a topic by their stamp (ns), in the order of the bag."""
    return {decode.stamp(m): convert(m) for _, m in bag.messages(topic)}


def _estimates(bag: Bag) -> dict[int, Fields]:
    """State estimates, as fields of MpcState, from the recorded odometry and IMU."""
    estimator = StateEstimator(read_estimator())
    fields = {}
    for topic, _, message in bag.merged("/odom", "/imu"):
        if topic == "/odom":
            estimator.add_odometry(*decode.odometry(message))
        else:
            estimator.add_imu(*decode.imu(message))
        while (estimate := estimator.poll()) is not None:
            fields[estimate.stamp] = _state_fields(estimate)
    return fields


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


def _previews(
    robot: Robot, states: Mapping[int, Any], previews: Mapping[int, GaitPreview]
) -> dict[int, Fields]:
    """Gait previews, as fields of GaitPreview, from the recorded states and commands."""
    first = next(iter(previews.values())).command
    scheduler = GaitScheduler(read_gaits(), robot, read_springs(), first.gait, first.velocity)
    fields = {}
    for stamp, (_, state, _, lead) in states.items():
        if stamp in previews:
            scheduler.set_command(previews[stamp].command)
            fields[stamp] = _preview_fields(scheduler.step(stamp + lead, state))
    return fields


def _preview_fields(preview: GaitPreview) -> Fields:
    names = ("phase", "period", "dt", "contact", "friction", "normal_force", "tendon_angle")
    return {name: getattr(preview, name) for name in (*names, "reference", "posture")}


def _solves(
    robot: Robot,
    states: Mapping[int, Any],
    previews: Mapping[int, Any],
    solved: Container[int],
) -> dict[int, Fields]:
    """Results of the MPC, as fields of GroundReactionForces, in the order of the states.

    The MPC keeps state between cycles. A state that the recorded controller skipped (its stamp is
    not in `solved`) is therefore skipped again.
    """
    settings = config.replace(read_mpc(), {"acceptance.time_budget": math.inf})
    mpc = Mpc(robot, settings, timer=lambda: 0.0)
    return {
        stamp: _forces_fields(mpc.step(state, previews[stamp]))
        for stamp, (_, state, *_) in states.items()
        if stamp in previews and stamp in solved
    }


def _forces_fields(result: MpcResult) -> Fields:
    names = [field.name for field in dataclasses.fields(result)]
    return {
        n: getattr(result, n) for n in names if n not in ("message", "solve_time", "status")
    } | {"status": int(result.status)}


def _angles(
    robot: Robot,
    forces: Mapping[int, Any],
    previews: Mapping[int, Any],
    states: Mapping[int, Any],
) -> dict[int, Fields]:
    """Tendon angles, as the field of JointState."""
    force_map = make_force_map(robot, read_force_map(), read_mpc().map)

    def angle(stamp: int, force: Any, status: int) -> Any:
        nominal = force_map.nominal(previews[stamp], states[stamp][1])
        return command_for(force_map, force, status, previews[stamp], nominal).angle

    return {
        stamp: {"position": angle(stamp, force, status)}
        for stamp, (_, force, status) in forces.items()
        if stamp in previews and stamp in states
    }


def _numbers(value: Any) -> np.ndarray:
    """A message's field as a flat array: numbers, arrays, vectors and arrays of vectors."""
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/replay`; exit code 0: equal, 1: a difference, 2: no replay."""
    parser = argparse.ArgumentParser(prog="scripts/replay", description=__doc__.split("\n\n")[0])
    parser.add_argument("bag", type=Path, help="directory of the bag")
    parser.add_argument("--namespace", default="", help="of the recorded graph")
    parser.add_argument(
        "--tolerance", type=_tolerance, default=TOLERANCE, help="in SI units (default: %(default)g)"
    )
    options = parser.parse_args(arguments)
    try:
        comparisons = replay(Bag(options.bag, options.namespace), options.tolerance)
    except (BagError, config.ConfigError) as error:
        print(f"scripts/replay: {error}", file=sys.stderr)
        return 2
    except ValueError as error:  # a recorded message that its node has rejected
        print(f"scripts/replay: {options.bag}: cannot be replayed: {error}", file=sys.stderr)
        return 2
    differences = [c.first for c in comparisons if c.first is not None]
    lines = [
        f"{c.topic:<25}{c.compared:5d} compared, largest difference {c.largest:.1e}"
        for c in comparisons
    ]
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
    sys.exit(main())
