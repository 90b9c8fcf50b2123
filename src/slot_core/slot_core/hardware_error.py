"""Hardware errors of the XL430-W250: the bits of its registers Hardware Error Status and Shutdown.

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
