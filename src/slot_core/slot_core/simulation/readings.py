"""Readings of the simulated robot, each with its stamp in ns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.safety.watchdog import ServoHealth
from slot_core.servos.servo_bus import JointReading


@dataclass(frozen=True)
class OdometryReading:
    """Pose of base_link in odom, twist in base_link, at `stamp` (ns)."""

    stamp: int
    position: Array  # (3,) m
    quaternion: Array  # (4,) x y z w
    velocity: Array  # (3,) m/s
    angular_velocity: Array  # (3,) rad/s


@dataclass(frozen=True)
class ImageReading:
    """Grey image of the camera at `stamp` (ns), mid exposure."""

    stamp: int
    grey: NDArray[np.uint8]  # (h, w)


@dataclass(frozen=True)
class ImuReading:
    """Angular velocity and specific force in base_link at `stamp` (ns)."""

    stamp: int
    angular_velocity: Array  # (3,) rad/s
    specific_force: Array  # (3,) m/s^2


@dataclass(frozen=True)
class TrueState:
    """Ground truth at `stamp` (ns): exact odometry, tension, ground force and shape of the legs."""

    stamp: int
    odometry: OdometryReading
    tension: Array  # (4,) N
    ground_force: Array  # (4, 3) N in odom
    nodes: Array  # (4, N, 3) m in odom
    directors: Array  # (4, N-1, 3) along the width of the segments, in odom; (4, 0, 3): none


@dataclass(frozen=True)
class StampedHealth:
    """Health of the servos at `stamp` (ns), on which the supervisor steps; None: not reported."""

    stamp: int
    health: ServoHealth | None


Reading = (
    OdometryReading
    | ImageReading
    | ImuReading
    | JointReading
    | TrueState
    | StampedHealth
)


def lost_odometry(stamp: int) -> OdometryReading:
    """The reading of a visual SLAM that is lost: a quaternion of zeros, as RTAB-Map publishes it."""
    return OdometryReading(
        stamp, np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(3)
    )
