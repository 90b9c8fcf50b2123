"""What the supervisor is told of the servos beside angles and torques."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slot_core.robot import Array
from slot_core.safety.command_gate import Action


@dataclass(frozen=True)
class ServoHealth:
    """What the driver knows of its servos and does with them, each (4,)."""

    action: Action
    reason: str  # why not PASS, or ""
    torque: NDArray[np.bool_]  # as read back
    silence: Array  # s since the last answer
    hardware_error: NDArray[np.int64]  # register 70
