"""Geometry: rotations by roll, pitch and yaw, rigid transforms, vectors in the plane.

Roll, pitch and yaw are those of R = Rz(yaw) Ry(pitch) Rx(roll) everywhere (REP-103); quaternions
are x y z w, of base_link in odom, with the same bits on every processor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from slot_core.arrays import Array
from slot_core.compiled import helper, kernel
from slot_core.elementary import atan2, cos, hypot, sin
from slot_core.matrices import inner, norm, product

Angle = TypeVar("Angle", float, Array)
# Axes of a camera's optical frame (z forward, x to the right of the image, y down) in camera_link
# (x forward, y left, z up).
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@helper
def roll_pitch_yaw(r):  # type: ignore[no-untyped-def]
    """Roll, pitch and yaw, rad, of a rotation matrix (3, 3), in a kernel."""
    level = math.sqrt(r[2, 1] * r[2, 1] + r[2, 2] * r[2, 2])
    return (
        atan2(r[2, 1], r[2, 2]),
        atan2(-r[2, 0], level),
        atan2(r[1, 0], r[0, 0]),
    )


def rpy_of(rotation: Array) -> Array:
    """Roll, pitch and yaw (..., 3), rad, of rotation matrices (..., 3, 3); within +-pi."""
    r = np.moveaxis(np.asarray(rotation, dtype=float), (-2, -1), (0, 1))
    level = hypot(r[2, 1], r[2, 2])
    return np.stack(
        [
            atan2(r[2, 1], r[2, 2]),
            atan2(-r[2, 0], level),
            atan2(r[1, 0], r[0, 0]),
        ],
        axis=-1,
    )


def matrix_of_rpy(rpy: Any) -> Array:
    """Rotation matrix (3, 3) of roll, pitch and yaw (3,), rad."""
    angles = np.asarray(rpy, dtype=float)
    (cr, cp, cy), (sr, sp, sy) = cos(angles).tolist(), sin(angles).tolist()
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return np.array(rows)


@helper
def set_rows(out, *rows):  # type: ignore[no-untyped-def]
    """Write three rows of numbers to a matrix (3, 3)."""
    for i in range(3):
        out[i, 0], out[i, 1], out[i, 2] = rows[i]


@helper
def rotation_matrix(out, q):  # type: ignore[no-untyped-def]
    """Rotation matrix (3, 3) of the unit quaternion q."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    set_rows(
        out,
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )


@kernel
def _set_matrices(quaternions, out):  # type: ignore[no-untyped-def]
    """Write `matrix_of_quaternion` of (n, 4) to out (n, 3, 3)."""
    for i in range(len(out)):
        q = quaternions[i]
        length = math.sqrt(inner(q, q))
        if length == 0.0:
            raise ValueError("a quaternion has norm zero")
        rotation_matrix(
            out[i],
            (q[0] / length, q[1] / length, q[2] / length, q[3] / length),
        )


def matrix_of_quaternion(quaternion: Any) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4), normalised.

    Raises ValueError for a quaternion of norm zero.
    """
    q = np.array(quaternion, dtype=float, order="C")
    out = np.empty((*q.shape[:-1], 3, 3))
    _set_matrices(q.reshape(-1, 4), out.reshape(-1, 3, 3))
    return out


def quaternion_of(rotation: Any) -> Array:
    """(4,) quaternion of a rotation matrix (3, 3), w >= 0.

    4 q q^T = K + 1, of which the column with the largest diagonal is taken (Bar-Itzhack 2000).
    """
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(rotation, float).tolist()
    x, y, z, w = (
        each + 1.0 for each in (a - e - i, e - a - i, i - a - e, a + e + i)
    )
    rows = (
        (x, d + b, g + c, h - f),
        (d + b, y, h + f, c - g),
        (g + c, h + f, z, d - b),
        (h - f, c - g, d - b, w),
    )
    q = np.array(rows[(x, y, z, w).index(max(x, y, z, w))]) + 0.0
    return q / norm(q) if q[3] >= 0.0 else -q / norm(q)


def quaternion_of_vector(vector: Array) -> Array:
    """(4,) quaternion of a rotation vector (3,), rad."""
    angle = norm(vector)
    share = sin(0.5 * angle) / angle if angle else 0.5
    return np.append(share * vector, cos(0.5 * angle))


def inverse_quaternion(quaternion: Array) -> Array:
    """(4,) unit quaternion x y z w of the rotation back."""
    return np.asarray(quaternion * np.array([-1.0, -1.0, -1.0, 1.0]))


def upward(roll: Any, pitch: Any) -> Array:
    """(3, ...) unit vector z of the world in the axes of a body with rolls and pitches (...), rad."""
    (sr, sp), (cr, cp) = sin([roll, pitch]), cos([roll, pitch])
    return np.array([-sp, cp * sr, cp * cr])


def quaternion_product(a: Array, b: Array) -> Array:
    """(4,) quaternion of the rotation b (4,), then a (4,)."""
    (x, y, z, w), (i, j, k, r) = a.tolist(), b.tolist()
    product = (
        w * i + r * x + (y * k - z * j),
        w * j + r * y + (z * i - x * k),
        w * k + r * z + (x * j - y * i),
        w * r - (0.0 + x * i + y * j + z * k),
    )
    return np.array(product)


@dataclass(frozen=True)
class Transform:
    """x -> rotation x + position: coordinates in a frame from those in a frame fixed in it."""

    rotation: Array  # (3, 3)
    position: Array  # (3,) m

    @classmethod
    def of(
        cls, position: Array | tuple[float, ...], rpy: Array | tuple[float, ...]
    ) -> Transform:
        """From a position (m) and Rz(yaw) Ry(pitch) Rx(roll), rad."""
        return cls(matrix_of_rpy(rpy), np.asarray(position, float))

    @property
    def inverse(self) -> Transform:
        """The transform back."""
        return Transform(
            self.rotation.T, -product(self.rotation.T, self.position)
        )

    def __matmul__(self, other: Transform) -> Transform:
        """First `other`, then this one."""
        return Transform(
            product(self.rotation, other.rotation),
            product(self.rotation, other.position) + self.position,
        )

    def apply(self, points: Array) -> Array:
        """Points (..., 3), m, transformed."""
        return (
            product(np.reshape(points, (-1, 3)), self.rotation.T).reshape(
                np.shape(points)
            )
            + self.position
        )

    @property
    def quaternion(self) -> Array:
        """(4,) x y z w."""
        return quaternion_of(self.rotation)


def optical(camera_link: Transform) -> Transform:
    """Transform of the optical frame from that of camera_link."""
    return camera_link @ Transform(OPTICAL, np.zeros(3))  # of transforms


@kernel
def _rotate(vectors, angles, out):  # type: ignore[no-untyped-def]
    """Write `rotate` of vectors (n, 2) or one, by angles (n,) or one, to out (n, 2)."""
    for i in range(len(out)):
        angle, v = angles[i % angles.size], vectors[i % len(vectors)]
        c, s = cos(angle), sin(angle)
        out[i, 0], out[i, 1] = c * v[0] - s * v[1], s * v[0] + c * v[1]


def rotate(vectors: Array, angle: float | Array) -> Array:
    """Rotate plane vectors (..., 2) counter-clockwise by an angle (...), rad."""
    angles, v = (
        np.array(angle, dtype=float, order="C"),
        np.array(vectors, dtype=float, order="C"),
    )
    if angles.size > 1 and v.ndim > 1 and angles.shape != v.shape[:-1]:
        shape = np.broadcast_shapes(angles.shape, v.shape[:-1])
        return rotate(
            np.broadcast_to(v, (*shape, 2)), np.broadcast_to(angles, shape)
        )
    out = np.empty((*(angles if v.ndim == 1 else v[..., 0]).shape, 2))
    _rotate(v.reshape(-1, v.shape[-1]), angles.reshape(-1), out.reshape(-1, 2))
    return out


def wrapped(angle: Angle) -> Angle:
    """An angle in [-pi, pi), or an array of them, rad."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
