"""Hardware errors of servos, as bits; another brand maps its own errors onto them.

They are those of the registers Hardware Error Status and Shutdown of the XL430-W250.
Source: ROBOTIS e-manual, XL430-W250, "Hardware Error Status".
"""

from __future__ import annotations

import enum


class HardwareError(enum.IntFlag):
    """Bits of Hardware Error Status; the same bits of Shutdown select which switch torque off."""

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    MOTOR_ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20


HARDWARE_ERROR_BITS = sum(HardwareError)  # all of them


def hardware_errors(bits: int) -> str:
    """Names of the bits set in a hardware error status, or "none"."""
    known = [
        str(error.name).lower().replace("_", " ")
        for error in HardwareError
        if bits & error
    ]
    other = [f"bit {k}" for k in range(8) if (bits & ~HARDWARE_ERROR_BITS) >> k & 1]
    return ", ".join(known + other) or "none"
