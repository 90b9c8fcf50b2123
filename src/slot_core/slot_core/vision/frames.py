"""Rigid transforms, and the axes of a camera.

`camera_link` has x forward, y left, z up (REP-103); the optical frame has z forward, x to the
right of the picture, y down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.robot import Array

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # in camera_link


@dataclass(frozen=True)
class Transform:
    """x -> rotation x + position: coordinates in a frame from those in a frame fixed in it."""

    rotation: Array  # (3, 3)
    position: Array  # (3,) m

    @classmethod
    def of(cls, position: Array | tuple[float, ...], rpy: Array | tuple[float, ...]) -> Transform:
        """From a position (m) and Rz(yaw) Ry(pitch) Rx(roll), rad."""
        return cls(Rotation.from_euler("xyz", rpy).as_matrix(), np.asarray(position, float))

    @classmethod
    def of_quaternion(cls, position: Array, quaternion: Array) -> Transform:
        """From a position (m) and a quaternion x y z w."""
        return cls(Rotation.from_quat(quaternion).as_matrix(), np.asarray(position, float))

    @property
    def inverse(self) -> Transform:
        """The transform back."""
        return Transform(self.rotation.T, -self.rotation.T @ self.position)

    def __matmul__(self, other: Transform) -> Transform:
        """First `other`, then this one."""
        return Transform(
            self.rotation @ other.rotation, self.rotation @ other.position + self.position
        )

    def apply(self, points: Array) -> Array:
        """Points (..., 3), m, transformed."""
        return points @ self.rotation.T + self.position

    @property
    def quaternion(self) -> Array:
        """(4,) x y z w."""
        return Rotation.from_matrix(self.rotation).as_quat()


def optical(camera_link: Transform) -> Transform:
    """Transform of the optical frame from that of camera_link."""
    return camera_link @ Transform(OPTICAL, np.zeros(3))
