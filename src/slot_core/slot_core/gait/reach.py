"""Reach of a gait: the part of a velocity that it can follow, on the same curve."""

from __future__ import annotations

import numpy as np

from slot_core.config import ConfigError
from slot_core.gait.gait import ROUNDING, SPEED_NAMES, GaitSettings, Posture, Stride
from slot_core.matrices import norm
from slot_core.robot import Array

TINY = 1e-12  # m/s, rad/s: no velocity


def clipped(settings: GaitSettings, name: str, velocity: Array) -> tuple[Array, str]:
    """The velocity (3,), as fast as a gait follows it, and one line on what was clipped, or "".

    All three are scaled alike, so that the robot keeps the curve. Raises ConfigError for an unknown
    gait, or a velocity that is not finite or not (3,).
    """
    gait, wanted = settings.find(name), np.array(velocity, dtype=float)
    if wanted.shape != (3,) or not np.isfinite(wanted).all():
        raise ConfigError(f"velocity {wanted}: expected three finite numbers")
    share = _share(gait, wanted)
    if share == 1.0:
        return wanted, ""
    pairs = zip(SPEED_NAMES, wanted, share * wanted)
    changes = ", ".join(f"{label} {v:.3g} to {c:.3g}" for label, v, c in pairs if v)
    return share * wanted, f"velocity clipped to the reach of gait {name}: {changes}"


def _share(gait: Posture | Stride, velocity: Array) -> float:
    """Largest factor s, at most 1, with which s times a velocity (3,) is reached.

    With v = |v_x, v_y| the yaw rate of a stride has to stay below the line from `turn` at s v = 0
    to the steering's rate at `walking_speed`, or below that rate beyond it.
    """
    if isinstance(gait, Posture):
        return 0.0 if velocity.any() else 1.0
    sizes, speed = np.abs(velocity), norm(velocity[:2])
    planar = norm(velocity[:2] / gait.speeds[:2] / gait.amplitude_max[:2])
    steering = min(gait.forward_steering.rate_max, gait.lateral_steering.rate_max)
    slope = (gait.turn.speed - steering) / gait.walking_speed
    turning = gait.turn.speed / max(sizes[2] + slope * speed, TINY)
    if turning * speed > gait.walking_speed:
        turning = steering / max(sizes[2], TINY)
    alone = np.min(gait.speeds / np.maximum(sizes, TINY))
    share = float(min(1.0 / max(planar, TINY), turning, alone))
    return share if share < 1.0 - ROUNDING else 1.0
