"""Readings as real drivers deliver them: functions of a reading, which return readings in its place.

Each takes the memory of its run as well, a dictionary that is empty at the start.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import LOCKSTEP_START, to_ns, to_seconds
from slot_core.geometry import (
    matrix_of_quaternion,
    matrix_of_rpy,
    quaternion_of_vector,
    quaternion_product,
    rpy_of,
)
from slot_core.simulation.readings import ImuReading, OdometryReading

Memory = dict[str, Any]
Readings = Sequence[Any]
Driver = Callable[[Any, Memory], Readings]
LEVEL = (0.0, 0.0, 0.0)  # rotation vector, rad


@dataclass(frozen=True)
class CovariantOdometry(OdometryReading):
    """Odometry with the variances (12,) of its message: angle, position, velocity, rate."""

    variance: Array


def in_frame(
    r: OdometryReading,
    _: Memory,
    origin: Sequence[float] = LEVEL,
    turn: Sequence[float] = LEVEL,
) -> Readings:
    """Odometry in a frame with another origin, m, turned by a rotation vector, rad."""
    back = quaternion_of_vector(-np.array(turn))
    place = matrix_of_quaternion(back) @ (r.position - np.array(origin))
    return [
        replace(
            r, position=place, quaternion=quaternion_product(back, r.quaternion)
        )
    ]


def started_slam(
    r: OdometryReading, memory: Memory, begin: float = 0.0
) -> Readings:
    """Odometry of a SLAM that starts at `begin`, s: place and heading of then are its origin."""
    if since_start(r) < begin:
        return [r]
    yaw = rpy_of(matrix_of_quaternion(r.quaternion))[2]
    frame = memory.setdefault("frame", (r.position, (0.0, 0.0, yaw)))
    return in_frame(r, memory, *frame)


def pose_only(r: OdometryReading, _: Memory, variance: float) -> Readings:
    """Odometry without twist: zeros of a variance that says so, or not."""
    variances, zero = np.repeat([0.0, variance], 6), np.zeros(3)
    pose = (r.stamp, r.position, r.quaternion)
    return [CovariantOdometry(*pose, zero, zero, variances)]


def twist_in_odom(r: OdometryReading, memory: Memory, yaw: float) -> Readings:
    """Twist in odom instead of base_link, in an odom that is turned by `yaw`, rad."""
    [given] = in_frame(r, memory, turn=(0.0, 0.0, yaw))
    rotation = matrix_of_quaternion(given.quaternion)
    twist = (rotation @ r.velocity, rotation @ r.angular_velocity)
    return [replace(given, velocity=twist[0], angular_velocity=twist[1])]


def shifted(r: Any, _: Memory, seconds: float) -> Readings:
    """Stamps shifted by a time."""
    return [replace(r, stamp=r.stamp + to_ns(seconds))]


def stray_stamp(r: Any, memory: Memory, time: float, ahead: float) -> Readings:
    """The first reading after `time` is stamped `ahead`, both s."""
    if since_start(r) < time or memory:
        return [r]
    memory["strayed"] = True
    return shifted(r, memory, ahead)


def repeated_stamps(r: Any, memory: Memory) -> Readings:
    """Every second reading with the stamp of the one before it."""
    if stamp := memory.pop("stamp", 0):
        return [replace(r, stamp=stamp)]
    memory["stamp"] = r.stamp
    return [r]


def other_sign(r: OdometryReading, memory: Memory) -> Readings:
    """Every second quaternion with the other sign."""
    memory["sign"] = -memory.get("sign", 1.0)
    return [replace(r, quaternion=memory["sign"] * r.quaternion)]


def dropped(r: Any, memory: Memory, share: float) -> Readings:
    """A share of the readings is lost, one by one."""
    rng = memory.setdefault("rng", np.random.default_rng(0))
    return [r] if rng.random() >= share else []


def lost(
    r: Any, _: Memory, begin: float = 0.0, duration: float = np.inf
) -> Readings:
    """No reading from `begin` on for `duration`, s."""
    return [] if begin <= since_start(r) < begin + duration else [r]


def other_imu(
    r: ImuReading,
    _: Memory,
    rpy_deg: Sequence[float] = LEVEL,
    rate: float = 1.0,
    force: float = 1.0,
    gravity: float = 0.0,
) -> Readings:
    """IMU turned in the torso, in other units, or of which a driver has removed gravity, m/s^2."""
    back = matrix_of_rpy(np.radians(rpy_deg)).T
    felt = r.specific_force - np.array([0.0, 0.0, gravity])
    turned = (rate * back @ r.angular_velocity, force * back @ felt)
    return [replace(r, angular_velocity=turned[0], specific_force=turned[1])]


def since_start(reading: Any) -> float:
    """Time of a reading since the start, s."""
    return to_seconds(reading.stamp - LOCKSTEP_START)
