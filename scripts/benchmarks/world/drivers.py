"""Readings as real drivers deliver them: functions of a reading, which return readings in its place.

A driver is made anew for every run, since some remember the readings before.
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
from slot_core.robot import GRAVITY
from slot_core.simulation.readings import OdometryReading

Driver = Callable[[Any], Sequence[Any]]
MakeDriver = Callable[[], Driver]
SEED = 0  # of the readings that a driver drops


@dataclass(frozen=True)
class CovariantOdometry(OdometryReading):
    """Odometry with the variances (12,) of its message: angle, position, velocity, rate."""

    variance: Array


def changed(**functions: Callable[[Any], Any]) -> MakeDriver:
    """Fields of every reading by name, as functions of the reading."""

    def driver(reading: Any) -> Sequence[Any]:
        values = {name: value(reading) for name, value in functions.items()}
        return [replace(reading, **values)]

    return lambda: driver


def in_frame(position: Sequence[float], turn: Sequence[float]) -> Driver:
    """Odometry in a frame whose origin is at `position` (3,), m, turned by the vector `turn`, rad."""
    back = quaternion_of_vector(-np.array(turn))
    rotation = matrix_of_quaternion(back)
    return changed(
        position=lambda r: rotation @ (r.position - np.array(position)),
        quaternion=lambda r: quaternion_product(back, r.quaternion),
    )()


def origin(*position: float, turn: Sequence[float] = (0, 0, 0)) -> MakeDriver:
    """Odometry with another origin, see `in_frame`."""
    return lambda: in_frame(position, turn)


def started_slam(begin: float = 0.0) -> MakeDriver:
    """Odometry of a SLAM that starts at `begin`, s: place and heading of then are its origin."""

    def make() -> Driver:
        frames: list[Driver] = []

        def driver(r: OdometryReading) -> Sequence[Any]:
            if _since_start(r) < begin:
                return [r]
            if not frames:
                yaw = rpy_of(matrix_of_quaternion(r.quaternion))[2]
                frames.append(in_frame(r.position.tolist(), (0, 0, yaw)))
            return frames[0](r)

        return driver

    return make


def pose_only(variance: float) -> MakeDriver:
    """Odometry without twist: zeros of a variance that says so, or not."""

    def driver(r: OdometryReading) -> Sequence[Any]:
        pose = (r.stamp, r.position, r.quaternion)
        variances = np.repeat([0.0, variance], 6)
        return [CovariantOdometry(*pose, np.zeros(3), np.zeros(3), variances)]

    return lambda: driver


def twist_in_odom(yaw: float) -> MakeDriver:
    """Twist in odom instead of base_link, in an odom that is turned by `yaw`, rad."""

    def make() -> Driver:
        frame = in_frame((0, 0, 0), (0, 0, yaw))

        def driver(r: OdometryReading) -> Sequence[Any]:
            [given] = frame(r)
            rotation = matrix_of_quaternion(given.quaternion)
            velocity = rotation @ r.velocity
            rate = rotation @ r.angular_velocity
            return [replace(given, velocity=velocity, angular_velocity=rate)]

        return driver

    return make


def shifted(seconds: float) -> MakeDriver:
    """Stamps shifted by a time, s."""
    return changed(stamp=lambda r: r.stamp + to_ns(seconds))


def stray_stamp(time: float, ahead: float) -> MakeDriver:
    """The first reading after `time` is stamped `ahead`, both s."""

    def make() -> Driver:
        strayed: list[int] = []

        def driver(r: Any) -> Sequence[Any]:
            if strayed or _since_start(r) < time:
                return [r]
            strayed.append(r.stamp)
            return [replace(r, stamp=r.stamp + to_ns(ahead))]

        return driver

    return make


def repeated_stamps() -> Driver:
    """Every second reading with the stamp of the one before it."""
    last: list[int] = []

    def driver(r: Any) -> Sequence[Any]:
        if last:
            return [replace(r, stamp=last.pop())]
        last.append(r.stamp)
        return [r]

    return driver


def other_sign() -> Driver:
    """Every second quaternion with the other sign."""
    sign = [1.0]

    def driver(r: OdometryReading) -> Sequence[Any]:
        sign[0] = -sign[0]
        return [replace(r, quaternion=sign[0] * r.quaternion)]

    return driver


def dropped(share: float) -> MakeDriver:
    """A share of the readings is lost, one by one."""

    def make() -> Driver:
        rng = np.random.default_rng(SEED)
        return lambda r: [r] if rng.random() >= share else []

    return make


def lost(begin: float = 0.0, duration: float = np.inf) -> MakeDriver:
    """No reading from `begin` on for `duration`, s."""

    def driver(r: Any) -> Sequence[Any]:
        return [] if begin <= _since_start(r) < begin + duration else [r]

    return lambda: driver


def turned_imu(*rpy_deg: float) -> MakeDriver:
    """IMU turned in the torso, but declared in base_link: roll, pitch, yaw, deg."""
    back = matrix_of_rpy(np.radians(rpy_deg)).T
    return changed(
        angular_velocity=lambda r: back @ r.angular_velocity,
        specific_force=lambda r: back @ r.specific_force,
    )


def scaled_imu(rate: float = 1.0, force: float = 1.0) -> MakeDriver:
    """IMU in other units."""
    return changed(
        angular_velocity=lambda r: rate * r.angular_velocity,
        specific_force=lambda r: force * r.specific_force,
    )


def without_gravity() -> Driver:
    """IMU whose driver has removed gravity, of a level torso."""
    weight = np.array([0.0, 0.0, GRAVITY])
    return changed(specific_force=lambda r: r.specific_force - weight)()


def _since_start(reading: Any) -> float:
    """Time of a reading since the start, s."""
    return to_seconds(reading.stamp - LOCKSTEP_START)
