"""Dynamixel servos as one of the brands of the registry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from slot_core.servos.brand import Brand

if TYPE_CHECKING:
    from slot_core.arrays import Array
    from slot_core.dynamixel.driver import Driver
    from slot_core.dynamixel.settings import DynamixelSettings
    from slot_core.servos.brand import EmulatedServos


def read_settings() -> DynamixelSettings:
    """The settings of `config/dynamixel.yaml`; raises ConfigError."""
    from slot_core.dynamixel import settings  # noqa: PLC0415 - heavy

    return settings.read_settings()


def make_bus(settings: DynamixelSettings) -> Driver:
    """Driver at the port of the settings, which is still closed."""
    from slot_core.dynamixel.driver import Driver  # noqa: PLC0415 - heavy
    from slot_core.dynamixel.port import SerialPort  # noqa: PLC0415

    return Driver(
        SerialPort(settings.bus.port, settings.bus.baud, settings.bus.timeout), settings
    )


def emulate(angles: Sequence[float] | Array, voltage: float) -> EmulatedServos:
    """Emulated servos as configured, at tendon angles (4,), rad, and a supply voltage (V)."""
    from slot_core.dynamixel.emulator import emulated_legs  # noqa: PLC0415 - not on a robot

    return emulated_legs.read_emulated_legs(angles, voltage)


def tools(arguments: Sequence[str] | None) -> int:
    """Command line for servos on the bench; returns the exit code."""
    from slot_core.dynamixel.tools_command import main  # noqa: PLC0415 - not on a robot

    return main(arguments)


DYNAMIXEL = Brand(read_settings, make_bus, emulate, tools)
