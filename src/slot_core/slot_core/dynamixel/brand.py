"""Dynamixel servos as one of the brands of the registry."""

from __future__ import annotations

from collections.abc import Sequence

from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.port import SerialPort
from slot_core.dynamixel.settings import DynamixelSettings, read_settings
from slot_core.robot import Array
from slot_core.servos.brand import Brand, EmulatedServos


def make_bus(settings: DynamixelSettings) -> Driver:
    """Driver at the port of the settings, which is still closed."""
    return Driver(SerialPort(settings.bus.port, settings.bus.baud, settings.bus.timeout), settings)


def emulate(angles: Sequence[float] | Array, voltage: float) -> EmulatedServos:
    """Emulated servos as configured, at tendon angles (4,), rad, and a supply voltage (V)."""
    from slot_core.dynamixel.emulator import emulated_legs  # noqa: PLC0415 - not on a robot

    return emulated_legs.read_emulated_legs(angles, voltage)


def tools(arguments: Sequence[str] | None) -> int:
    """Command line for servos on the bench; returns the exit code."""
    from slot_core.dynamixel.tools import main  # noqa: PLC0415 - not on a robot

    return main(arguments)


DYNAMIXEL = Brand(read_settings, make_bus, emulate, tools)
