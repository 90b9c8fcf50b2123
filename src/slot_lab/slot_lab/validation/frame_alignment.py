"""Alignment of a measurement's frame with the frame of a run.

The rotation R and shift d minimise sum |R m_i + d - r_i|^2 over the samples of all points
(W. Kabsch, Acta Cryst. A 34, 1978, 827; det R = 1). What is free:

    rigid   R and d: the measurement is in a frame of its own, as that of a camera
    level   turn about z, and d: both have z upwards
    none    nothing: both are in one frame

The alignment removes errors in what it fits: with `rigid` place, heading and inclination.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.geometry import rpy_of

RIGID = "rigid"


@dataclass(frozen=True)
class FrameAlignment:
    """x_run = rotation x_measurement + shift."""

    rotation: Array  # (3, 3)
    shift: Array  # (3,) m

    def apply(self, points: Array) -> Array:
        """Points (n, 3) of the measurement in the frame of the run."""
        return np.asarray(points @ self.rotation.T + self.shift)

    def attitude(self, rpy: Array) -> Array:
        """Attitudes (n, 3) of the measurement in the frame of the run, yaw unwrapped."""
        turned = Rotation.from_matrix(self.rotation) * Rotation.from_euler("xyz", rpy)
        return np.unwrap(rpy_of(turned.as_matrix()), axis=0)


def align_frames(measured: Array, run: Array, frame: str) -> FrameAlignment:
    """Alignment of points (n, 3) with points (n, 3) of the run."""
    if frame == "none":
        return FrameAlignment(np.eye(3), np.zeros(3))
    centre, target = measured.mean(axis=0), run.mean(axis=0)
    rotation = best_rotation((measured - centre).T @ (run - target), frame)
    return FrameAlignment(rotation, target - rotation @ centre)


def best_rotation(covariance: Array, frame: str) -> Array:
    """(3, 3) rotation R with the largest trace(R H) of a cross-covariance H = sum m r^T (3, 3)."""
    if frame == "none":
        return np.eye(3)
    if frame == "level":
        h = covariance
        angle = np.arctan2(h[0, 1] - h[1, 0], h[0, 0] + h[1, 1])
        return np.asarray(Rotation.from_euler("z", angle).as_matrix())
    left, _, right = np.linalg.svd(covariance)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray((left * sign @ right).T)
