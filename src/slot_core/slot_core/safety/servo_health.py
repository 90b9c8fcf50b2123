"""Health report of the servos: from the driver, or from simulated servos."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slot_core.robot import LEGS, Array
from slot_core.safety.command_gate import Action


@dataclass(frozen=True)
class ServoHealth:
    """State of the servos and their action on commands; arrays (4,) in the order of LEGS."""

    action: Action
    reason: str  # why the action is not PASS, or ""
    torque: NDArray[np.bool_]  # as read back
    silence: Array  # s since the last answer; inf: never answered
    goal: Array  # rad, tendon angles sent to the servos last
    slewed: NDArray[np.bool_]  # whether the rate limit held the goal back
    hardware_error: NDArray[np.int64]  # register 70 of the XL430-W250
    temperature: Array  # degC; NaN: not known
    voltage: Array  # V; NaN: not known
    error_rate: Array  # share of the last exchanges that failed
    commanded: int = 0  # ns, stamp of the command written last, in lockstep arrived last; 0: none
    written: int = 0  # ns, time of that


def healthy_servos(
    action: Action,
    reason: str,
    torque: bool,
    goal: Array,
    slewed: NDArray[np.bool_] | None = None,
    *,
    voltage: float = math.nan,
) -> ServoHealth:
    """Health of servos without faults: simulated ones without a bus, at a supply voltage (V)."""
    count = len(LEGS)
    return ServoHealth(
        action=action,
        reason=reason,
        torque=np.full(count, torque),
        silence=np.zeros(count),
        goal=goal,
        slewed=np.zeros(count, dtype=bool) if slewed is None else slewed,
        hardware_error=np.zeros(count, dtype=np.int64),
        temperature=np.full(count, np.nan),
        voltage=np.full(count, voltage),
        error_rate=np.zeros(count),
    )
