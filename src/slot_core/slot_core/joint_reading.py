"""Reading of the four joints, by the driver of real servos or of the simulated robot."""

from __future__ import annotations

from dataclasses import dataclass

from slot_core.robot import Array


@dataclass(frozen=True)
class JointReading:
    """Tendon angles (rad), rates (rad/s) and servo torques (N m), each (4,), at `stamp` (ns)."""

    stamp: int
    angle: Array
    rate: Array
    torque: Array
