"""Checks of the servos: model, firmware and EEPROM against the configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from slot_core.dynamixel.bus import Bus
from slot_core.dynamixel.errors import CommunicationError, InstructionError
from slot_core.dynamixel.joints import Joint
from slot_core.dynamixel.settings import DynamixelSettings
from slot_core.dynamixel.table import BAUD_RATES


@dataclass(frozen=True)
class ServoInfo:
    """Identity of a servo; `values`: its EEPROM by register name."""

    leg: str
    id: int
    model: int
    firmware: int
    values: Mapping[str, int]


def inspect(bus: Bus, joint: Joint) -> ServoInfo:
    """Read identity and EEPROM of a servo; raises CommunicationError, InstructionError."""
    model, firmware = bus.ping(joint.id)
    values: dict[str, int] = {}
    for first, last in (
        ("id", "protocol_type"),
        ("homing_offset", "moving_threshold"),
        ("temperature_limit", "pwm_limit"),
        ("velocity_limit", "min_position_limit"),
        ("startup_configuration", None),
        ("shutdown", None),
    ):
        values |= bus.read(joint.id, first, last)
    return ServoInfo(joint.leg, joint.id, model, firmware, values)


def expected(settings: DynamixelSettings, joint: Joint) -> dict[str, int]:
    """EEPROM values that the configuration requires of a servo, by register name."""
    low, high = joint.limits()
    return settings.servo.eeprom() | {
        "operating_mode": settings.mode,
        "min_position_limit": low,
        "max_position_limit": high,
        "baud_rate": BAUD_RATES.index(settings.bus.baud),
    }


def differences(
    settings: DynamixelSettings, joint: Joint, info: ServoInfo
) -> list[str]:
    """Differences of a servo from the configuration, one line each; empty if there are none."""
    setup, reasons = settings.servo, []
    if info.model != setup.model:
        reasons.append(f"{joint.name}: model {info.model}, expected {setup.model}")
    if info.firmware < setup.firmware_min:
        reasons.append(
            f"{joint.name}: firmware {info.firmware}, expected {setup.firmware_min} or newer"
        )
    return reasons + [
        f"{joint.name}: {name} is {info.values[name]}, expected {value}"
        for name, value in expected(settings, joint).items()
        if info.values[name] != value
    ]


def examine(
    bus: Bus, settings: DynamixelSettings, joint: Joint
) -> tuple[ServoInfo | None, list[str]]:
    """Identity and differences of a servo; None and the error if it does not answer."""
    try:
        info = inspect(bus, joint)
    except (CommunicationError, InstructionError) as error:
        return None, [str(error)]
    return info, differences(settings, joint, info)
