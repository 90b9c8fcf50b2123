"""A command: tendon angles at the time of its acceptance, and their rate until the next one."""

from __future__ import annotations

import enum

import numpy as np

from slot_core.robot import LEGS, Array


class Action(enum.Enum):
    """Reaction of the servos to commands."""

    PASS = "pass"  # follow them, rate-limited
    HOLD = "hold"  # keep the last goals
    RELAX = "relax"  # a ramp to slack, then torque off
    OFF = "off"  # torque off at once


AT_REST = np.zeros(len(LEGS))
"""Rate (4,), rad/s, of a command whose angles stay."""
AT_REST.flags.writeable = False
EXTRAPOLATION_MAX = 0.1  # s after a command in which the goals continue at its rate


def extrapolated(angle: Array, rate: Array, age: float | Array) -> Array:
    """Angles (..., 4), rad, that commands have reached at their rates (..., 4), rad/s, and ages, s.

    age: (...) or one for all; at most EXTRAPOLATION_MAX counts.
    """
    passed = np.minimum(np.maximum(age, 0.0), EXTRAPOLATION_MAX)
    return angle + passed[..., None] * rate


def command_fault(angle: Array, rate: Array, low: float, high: float) -> str:
    """One line that names the first angle outside [low, high] or value not finite, or ""."""
    for name, values in (("command", angle), ("rate", rate)):
        if np.shape(values) != (len(LEGS),):
            return f"{name} has the shape {np.shape(values)}, limit ({len(LEGS)},)"
    for leg, value in zip(LEGS, angle):
        if not low <= value <= high:  # NaN is not
            return (
                f"command {leg} = {value:.4g} rad is not inside [{low:.4g}, {high:.4g}]"
            )
    for leg, value in zip(LEGS, rate):
        if not np.isfinite(value):
            return f"rate {leg} = {value:.4g} rad/s is not finite"
    return ""
