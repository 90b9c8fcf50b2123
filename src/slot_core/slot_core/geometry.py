"""Geometry in the plane: vectors rotated by an angle, angles wrapped."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from slot_core.robot import Array

Angle = TypeVar("Angle", float, Array)


def rotate(vectors: Array, angle: float | Array) -> Array:
    """Rotate plane vectors (..., 2) counter-clockwise by an angle (...), rad."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def wrapped(angle: Angle) -> Angle:
    """An angle in [-pi, pi), or an array of them, rad."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
