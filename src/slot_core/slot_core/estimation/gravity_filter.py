"""Gravity filter: the direction of gravity in odom, from the IMU and the velocity of the torso.

The specific force R f of a torso with velocity v in odom is v' - g. Over their means m_f and m_v
with a time constant T (x' + m / T = .. / T),

    g = (v - m_v) / T - m_f,

whatever the torso's motion, and whatever odom's z axis is. The bias of the accelerometer is part of
it: 0.1 m/s^2 are 0.6 deg.
"""

import numpy as np

from slot_core.arrays import Array
from slot_core.key_frame import StateParts
from slot_core.matrices import norm
from slot_core.robot import GRAVITY

TIME = 0.5  # s, T: most of a stride, so that errors of the velocity are 2 mg
LEAST = 5.0  # m/s^2, of a mean specific force that is gravity's
DOWN = np.array([0.0, 0.0, -GRAVITY])
DOWN.flags.writeable = False


class GravityFilter:
    """Means of the specific force and the velocity."""

    STATE = StateParts("_force", "_velocity")

    def __init__(self) -> None:
        self._force, self._velocity = -DOWN, np.full(3, np.nan)

    def add(self, force: Array, velocity: Array, dt: float) -> None:
        """Take the mean specific force (3,) m/s^2 of the last dt (s), and the velocity (3,) m/s.

        Both in odom.
        """
        share = min(1.0, dt / TIME)
        if np.isnan(self._velocity[0]):
            self._force, self._velocity = force, velocity
        self._force = self._force + share * (force - self._force)
        self._velocity = self._velocity + share * (velocity - self._velocity)

    def value(self, velocity: Array) -> Array:
        """Gravity (3,) m/s^2 in odom, of the length of gravity; straight down while unknown."""
        if np.isnan(self._velocity[0]):
            return DOWN.copy()
        g = (velocity - self._velocity) / TIME - self._force
        length = norm(g)
        return g * (GRAVITY / length) if length > LEAST else DOWN.copy()
