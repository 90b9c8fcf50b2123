"""Motion and tendon angles of any bag, refused unless they are sound.

Sound: finite values, stamps that increase, quaternions of length one. Equal messages with one stamp
count once. Odometry with a quaternion of zeros says that it is lost, and is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.clock import to_seconds
from slot_lab.bags.bag import Bag, BagError, Stamps
from slot_lab.bags.recorded_walk import (
    TorsoTrack,
    joint_columns,
    last_states,
    seconds,
)
from slot_lab.bags.topics import (
    COMMANDED,
    ESTIMATE,
    MEASURED,
    MOTION_TOPICS,
)

UNIT = 0.01  # largest deviation of a quaternion's length from one


@dataclass(frozen=True)
class TendonAngles:
    """Tendon angles over n samples."""

    source: str  # topic, or columns of a CSV file
    t: Array  # (n,) s, graph time
    angle: Array  # (n, 4) rad
    rate: Array | None = (
        None  # (n, 4) rad/s, at which a command goes on; None: it stays
    )
    measured: bool = True  # else they are commands


def measured_motion(bag: Bag, topic: str = "") -> TorsoTrack:
    """The torso's motion from a topic of MOTION_TOPICS (default: the first that is recorded).

    Raises BagError if there is none, for fewer than two samples, and if they are not sound.
    """
    chosen = _chosen(bag, topic, MOTION_TOPICS)
    read = _state if chosen == ESTIMATE else _odometry
    stamps, position, attitude, velocity = read(bag, chosen)
    where = f"{bag.path}: {chosen}"
    left_out = 0
    if chosen != ESTIMATE:
        known = attitude.any(axis=1)
        left_out = int(np.sum(~known))
        stamps, attitude = stamps[known], attitude[known]
        position, velocity = position[known], velocity[known]
    keep = sound(where, stamps, np.hstack([position, attitude, velocity]))
    position, attitude, velocity = position[keep], attitude[keep], velocity[keep]
    if chosen == ESTIMATE:
        rotation = Rotation.from_euler("xyz", attitude)
    else:
        rotation = _unit(where, attitude)
        velocity = rotation.apply(velocity)
    return TorsoTrack(
        chosen, seconds(stamps[keep]), position, rotation.as_quat(), velocity, left_out
    )


def tendon_angles(bag: Bag, topic: str = "") -> TendonAngles:
    """Measured tendon angles if recorded, else the commands; or those of the topic.

    Raises BagError if there are none, for fewer than two samples, and if they are not sound.
    """
    chosen = _chosen(bag, topic, (MEASURED, COMMANDED))
    t, angle = joint_columns(bag, chosen, "position")
    series, rate = bag.series(chosen, "velocity"), None
    if chosen != MEASURED and series["velocity"].size:
        _, rate = joint_columns(bag, chosen, "velocity")
    values = angle if rate is None else np.hstack([angle, rate])
    keep = sound(f"{bag.path}: {chosen}", series.stamp, values)
    kept = None if rate is None else rate[keep]
    return TendonAngles(chosen, t[keep], angle[keep], kept, measured=chosen == MEASURED)


def sound(where: str, stamps: Stamps, values: Array) -> NDArray[np.intp]:
    """Indices of the samples (n, m) to keep: all but the repetitions of equal ones.

    Raises BagError for a value that is not finite, a stamp before the one before it, two different
    samples of one stamp, and fewer than two samples.
    """
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        raise BagError(
            f"{where}: message {int(np.argmax(bad))} holds a value that is not finite"
        )
    step = np.diff(stamps)
    if (step < 0).any():
        k = int(np.argmax(step < 0))
        raise BagError(
            f"{where}: time goes back by {to_seconds(-step[k]):g} s after message {k}"
        )
    same = (values[1:] == values[:-1]).all(axis=1)
    if (clash := (step == 0) & ~same).any():
        raise BagError(
            f"{where}: messages {int(np.argmax(clash))} and the next have one stamp"
        )
    keep = np.flatnonzero(np.concatenate([[True], step > 0]))
    if len(keep) < 2:
        raise BagError(f"{where}: {len(keep)} samples, less than 2")
    return keep


def _chosen(bag: Bag, topic: str, known: Sequence[str]) -> str:
    if topic:
        if not bag.counts.get(topic):
            raise BagError(f"{bag.path}: {topic} holds no messages")
        return topic
    for name in known:
        if bag.counts.get(name):
            return name
    raise BagError(f"{bag.path}: holds none of {', '.join(known)}")


def _odometry(bag: Bag, topic: str) -> tuple[Stamps, Array, Array, Array]:
    """Stamps, position, quaternion x y z w, velocity in base_link."""
    fields = ("pose.pose.position", "pose.pose.orientation", "twist.twist.linear")
    series = bag.series(topic, *fields)
    return series.stamp, *(series[field] for field in fields)  # type: ignore[return-value]


def _state(bag: Bag, topic: str) -> tuple[Stamps, Array, Array, Array]:
    """Times of the state (stamp and lead), position, roll pitch yaw, velocity in odom."""
    fields = ("position", "rpy", "linear_velocity")
    series = bag.series(topic, *fields, "lead")
    time, last = last_states(series)
    position, rpy, velocity = (series[field][last] for field in fields)
    return time, position, rpy, velocity


def _unit(where: str, quaternion: Array) -> Rotation:
    """Rotations of quaternions (n, 4); raises BagError where one has not the length one."""
    length = np.linalg.norm(quaternion, axis=1)
    if (off := np.abs(length - 1.0) > UNIT).any():
        k = int(np.argmax(off))
        raise BagError(
            f"{where}: the quaternion of sample {k} has the length {length[k]:.4g}"
        )
    return Rotation.from_quat(quaternion)
