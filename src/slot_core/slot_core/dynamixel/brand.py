"""Dynamixel servos as one of the brands of the registry."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from slot_core import config
from slot_core.command_line import CommandParser, command_parser
from slot_core.dynamixel.table import BAUD_RATES
from slot_core.names import LEGS
from slot_core.servos.brand import Brand

if TYPE_CHECKING:
    from slot_core.arrays import Array
    from slot_core.dynamixel.driver import Driver
    from slot_core.dynamixel.settings import DynamixelSettings
    from slot_core.servos.brand import EmulatedServos

TOOLS = """Dynamixel servos on the bench: scan, inspect, set up, zero or emulate them.

scan      list the servos that answer, with their baud rates
info      print state of the four servos and differences from the configuration
assign    set id and baud rate of the only servo on the line
prepare   write the configuration into the servos' EEPROM
zero      measure the servo angle at which a leg's tendon is relaxed (torque off)
move      move the tendon of one leg to an angle (deg) and back, the others free
emulate   emulate the four servos on a pseudo-terminal, until interrupted
"""


def read_settings() -> DynamixelSettings:
    """The settings of `config/dynamixel.yaml`; raises ConfigError."""
    from slot_core.dynamixel import settings  # noqa: PLC0415 - heavy

    return settings.read_settings()


def make_bus(settings: DynamixelSettings) -> Driver:
    """Driver at the port of the settings, which is still closed."""
    from slot_core.dynamixel.driver import Driver  # noqa: PLC0415 - heavy
    from slot_core.dynamixel.port import SerialPort  # noqa: PLC0415

    return Driver(
        SerialPort(settings.bus.port, settings.bus.baud, settings.bus.timeout),
        settings,
    )


def emulate(angles: Sequence[float] | Array, voltage: float) -> EmulatedServos:
    """Emulated servos as configured, at tendon angles (4,), rad, and a supply voltage (V)."""
    from slot_core.dynamixel.emulator import emulated_bus, emulated_legs  # noqa: PLC0415 - not on a robot

    emulator = config.replace(
        emulated_bus.read_emulator(), {"servo.voltage": voltage}
    )
    return emulated_legs.EmulatedDynamixels(read_settings(), emulator, angles)


def tools(arguments: Sequence[str] | None) -> int:
    """Command line for servos on the bench; returns the exit code."""
    options = _parser().parse_args(arguments)
    from slot_core.dynamixel.tools import use  # noqa: PLC0415 - heavy, and not on a robot

    return use(options)


def _parser() -> CommandParser:
    parser = command_parser("servos", TOOLS)
    parser.add_argument(
        "--port",
        metavar="DEVICE",
        help="serial port; default: of config/dynamixel.yaml",
    )
    parser.add_argument(
        "--baud",
        metavar="N",
        type=int,
        help="baud rate; default: configured, scan: all",
    )
    actions = parser.add_subparsers(dest="action", required=True)
    for name in ("scan", "info", "prepare"):
        actions.add_parser(name)
    assign = actions.add_parser("assign")
    assign.add_argument("id", type=int, choices=range(253), metavar="ID")
    assign.add_argument(
        "--to-baud", type=int, choices=BAUD_RATES, help="new baud rate"
    )
    zero = actions.add_parser("zero")
    zero.add_argument("leg", choices=LEGS)
    zero.add_argument(
        "--write", action="store_true", help="to config/dynamixel.yaml"
    )
    move = actions.add_parser("move")
    move.add_argument("leg", choices=LEGS)
    move.add_argument("angle", type=float, metavar="ANGLE", help="deg")
    move.add_argument(
        "--rate", type=float, default=5.0, help="deg/s (default: %(default)s)"
    )
    emulate = actions.add_parser("emulate")
    emulate.add_argument(
        "--new",
        choices=LEGS,
        help="this servo alone on the line, as the maker delivers it",
    )
    emulate.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="KIND:LEG[:VALUE]",
        help="a fault from the start; may be given several times",
    )
    emulate.add_argument("--link", type=Path, help="symbolic link to the port")
    emulate.add_argument(
        "--usb-latency", type=float, help="latency of the emulated adapter, s"
    )
    return parser


DYNAMIXEL = Brand(read_settings, make_bus, emulate, tools)
