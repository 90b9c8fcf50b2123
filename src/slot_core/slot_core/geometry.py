"""Geometry: rotations by roll, pitch and yaw, rigid transforms, vectors in the plane.

Roll, pitch and yaw are those of R = Rz(yaw) Ry(pitch) Rx(roll) everywhere (REP-103); quaternions
are x y z w.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.robot import Array

Angle = TypeVar("Angle", float, Array)
# Axes of a camera's optical frame (z forward, x to the right of the image, y down) in camera_link
# (x forward, y left, z up).
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def rotation_of(rpy: Any) -> Rotation:
    """Rotations of roll, pitch and yaw (..., 3), rad."""
    return Rotation.from_euler("xyz", rpy)


def rpy_of(rotation: Rotation) -> Array:
    """Roll, pitch and yaw (..., 3), rad, of rotations; yaw and roll in (-pi, pi]."""
    return np.asarray(rotation.as_euler("xyz"))


@dataclass(frozen=True)
class Transform:
    """x -> rotation x + position: coordinates in a frame from those in a frame fixed in it."""

    rotation: Array  # (3, 3)
    position: Array  # (3,) m

    @classmethod
    def of(cls, position: Array | tuple[float, ...], rpy: Array | tuple[float, ...]) -> Transform:
        """From a position (m) and Rz(yaw) Ry(pitch) Rx(roll), rad."""
        return cls(rotation_of(rpy).as_matrix(), np.asarray(position, float))

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


def rotate(vectors: Array, angle: float | Array) -> Array:
    """Rotate plane vectors (..., 2) counter-clockwise by an angle (...), rad."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def wrapped(angle: Angle) -> Angle:
    """An angle in [-pi, pi), or an array of them, rad."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
