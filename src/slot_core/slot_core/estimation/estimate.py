"""Estimated state of the torso, as the state estimator publishes it for a control tick."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np

from slot_core.arrays import Array
from slot_core.estimation.floor_observer import LEVEL, FloorPlane
from slot_core.estimation.inertial_filter import DOWN


class Validity(enum.IntEnum):
    """Validity of an estimate, with the values of slot_msgs/msg/MpcState."""

    VALID = 0
    INITIALISING = 1
    ODOMETRY_REJECTED = 2
    IMU_MISSING = 3
    ODOMETRY_LOST = 4
    ODOMETRY_SLOW = 5


USABLE = (Validity.VALID, Validity.IMU_MISSING)
"""Validities of a state on which the robot may move."""


@dataclass(frozen=True)
class Estimate:
    """State of the torso for a control tick, predicted to the time when its command takes effect.

    `stamp` names the tick, on the time of the IMU. The state is [roll pitch yaw, p, omega, v]:
    rad, m, rad/s, m/s, all in the floor's frame, with R = Rz(yaw) Ry(pitch) Rx(roll) and yaw in
    (-pi, pi].
    """

    stamp: int  # ns
    state: Array  # (12,)
    covariance: Array  # (12, 12), in the order of the state
    validity: Validity
    lead: int = 0  # ns, from `stamp` to the time of the state
    # stiffness of the legs over the robot's weight, relative to the leg table
    leg_stiffness: float = 1.0
    legs_are_known: bool = True  # whether that is measured, or cannot be
    message: str = ""  # one line: why it is unusable, or what was compensated
    floor: FloorPlane = LEVEL  # in odom
    # (3,) m/s^2, in the floor's frame: a slope tilts it
    gravity: Array = field(default_factory=DOWN.copy)

    @classmethod
    def exact(cls, state: Array, stamp: int = 0) -> Estimate:
        """A valid estimate without uncertainty of a known state (12,)."""
        return cls(stamp, np.asarray(state), np.zeros((12, 12)), Validity.VALID)

    @property
    def time(self) -> int:
        """Time of the state, ns."""
        return self.stamp + self.lead
