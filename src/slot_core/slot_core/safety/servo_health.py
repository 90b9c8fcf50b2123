"""Health report of the servos: from the driver, or from simulated servos."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from slot_core.robot import LEGS, Array
from slot_core.safety.commands import Action

ZEROS, UNKNOWN = partial(np.zeros, len(LEGS)), partial(np.full, len(LEGS), np.nan)


def _no() -> NDArray[np.bool_]:
    return np.zeros(len(LEGS), dtype=np.bool_)


def _no_error() -> NDArray[np.int64]:
    return np.zeros(len(LEGS), dtype=np.int64)


@dataclass(frozen=True)
class ServoHealth:
    """State of the servos and their action on commands; arrays (4,) in the order of LEGS.

    The values left out are those of servos without faults.
    """

    action: Action
    reason: str  # why the action is not PASS, or ""
    torque: NDArray[np.bool_]  # as read back
    goal: Array  # rad, tendon angles sent to the servos last
    slewed: NDArray[np.bool_] = field(
        default_factory=_no
    )  # whether the rate limit held it back
    silence: Array = field(
        default_factory=ZEROS
    )  # s since the last answer; inf: never answered
    hardware_error: NDArray[np.int64] = field(
        default_factory=_no_error
    )  # bits of HardwareError
    temperature: Array = field(default_factory=UNKNOWN)  # degC; NaN: not known
    voltage: Array = field(default_factory=UNKNOWN)  # V; NaN: not known
    error_rate: Array = field(
        default_factory=ZEROS
    )  # share of the last exchanges that failed
    commanded: int = (
        0  # ns, stamp of the command written last, in lockstep arrived last; 0: none
    )
    written: int = 0  # ns, time of that
    supervised: int = (
        0  # ns, stamp of the first message of a supervisor that they took; 0: none
    )
