"""Tools for Dynamixel servos on the bench; each returns its exit code."""

import argparse
import contextlib
import dataclasses
import math
import signal
import sys
import time
from collections.abc import Callable

from slot_core import config
from slot_core.command_line import refuse
from slot_core.config import ConfigError
from slot_core.dynamixel.bus import Bus
from slot_core.dynamixel.checks import (
    examine,
    expected,
    measure_zero,
    write_zero,
)
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.emulator.emulated_legs import EmulatedDynamixels
from slot_core.dynamixel.joints import Joint, joints
from slot_core.dynamixel.port import BaudRateError, SerialPort, check_latency
from slot_core.dynamixel.settings import DynamixelSettings, read_settings
from slot_core.dynamixel.table import BAUD_RATES, VOLTAGE_UNIT
from slot_core.faults import hardware_errors
from slot_core.robot import LEGS
from slot_core.servos.servo_bus import RefusedError, ServoError

PERIOD = 0.002  # s, between two steps of the emulated servos
FAILED = 1  # exit code


def use(options: argparse.Namespace) -> int:
    """Run the tool that the command line names; returns the exit code."""
    try:
        settings = read_settings()
        bus = dataclasses.replace(
            settings.bus,
            **{
                k: v
                for k, v in (("port", options.port), ("baud", options.baud))
                if v
            },
        )
        return TOOLS[options.action](
            dataclasses.replace(settings, bus=bus), options
        )
    except RefusedError as error:
        print("\n".join(error.reasons), file=sys.stderr)
    except (ServoError, ConfigError, ValueError, OSError) as error:
        refuse("scripts/servos", error)
    return FAILED


def scan(settings: DynamixelSettings, options: argparse.Namespace) -> int:
    """List the servos that answer, at every baud rate the port supports, fastest first."""
    rates = (
        [options.baud] if options.baud else sorted(BAUD_RATES, key=lambda b: -b)
    )
    found = 0
    for baud in rates:
        try:
            bus = _open(settings, baud)
        except BaudRateError:
            continue
        for identity, (model, firmware) in bus.scan().items():
            print(
                f"{baud:>8} baud  id {identity:>3}  model {model}  firmware {firmware}"
            )
            found += 1
        bus.port.close()
    if not found:
        print("no servo answered: check power, cable and port", file=sys.stderr)
    return 0 if found else FAILED


def info(settings: DynamixelSettings, options: argparse.Namespace) -> int:
    """Print state of the four servos and differences from the configuration; exit code 0: none."""
    bus, faulty = _open(settings), 0
    for joint in joints(settings.joints):
        found, reasons = examine(bus, settings, joint)
        if found is not None:
            print(
                f"{joint.name}: model {found.model}, firmware {found.firmware}"
            )
            print(f"  {_state(bus, joint)}")
        for reason in reasons:
            print(f"  {reason}")
        faulty += bool(reasons)
    return FAILED if faulty else 0


def assign(settings: DynamixelSettings, options: argparse.Namespace) -> int:
    """Set the id and optionally the baud rate of the only servo on the line."""
    bus = _open(settings)
    present = list(bus.scan())
    if len(present) != 1:
        raise RefusedError(
            [
                f"{len(present)} servos on the line {present}, expected exactly one"
            ]
        )
    bus.write_verified(present[0], "torque_enable", 0)
    bus.write(present[0], "id", options.id)
    if options.to_baud:
        bus.write(options.id, "baud_rate", BAUD_RATES.index(options.to_baud))
        bus.port.close()
        bus = _open(settings, options.to_baud)
    bus.ping(options.id)
    print(f"id {options.id} at {options.to_baud or settings.bus.baud} baud")
    return 0


def prepare(settings: DynamixelSettings, options: argparse.Namespace) -> int:
    """Write the configuration into the servos' EEPROM, where it differs; torque off."""
    bus = _open(settings)
    for joint in joints(settings.joints):
        found, reasons = examine(bus, settings, joint)
        if found is None:
            raise RefusedError(reasons)
        bus.write_verified(joint.id, "torque_enable", 0)
        for name, value in expected(settings, joint).items():
            if found.values[name] != value:
                bus.write_verified(joint.id, name, value)
                print(f"{joint.name}: {name} {found.values[name]} -> {value}")
        _, remaining = examine(bus, settings, joint)
        if remaining:
            raise RefusedError(remaining)
    return 0


def zero(settings: DynamixelSettings, options: argparse.Namespace) -> int:
    """Measure the zero of a leg at its present position; optionally write it."""
    joint = joints(settings.joints)[LEGS.index(options.leg)]
    angle = measure_zero(_open(settings), joint, time.sleep)
    print(
        f"{joint.name}: zero at {angle:.2f} deg,"
        f" {math.degrees(joint.zero):.2f} deg before"
    )
    if options.write:
        print(
            f"written to {write_zero(options.leg, angle)}; now run scripts/servos prepare"
        )
    return 0


def emulate(settings: DynamixelSettings, options: argparse.Namespace) -> int:
    """Emulate four configured servos with relaxed tendons on a pseudo-terminal."""
    latency = options.usb_latency
    changes = {} if latency is None else {"usb_latency": latency}
    servos = EmulatedDynamixels(
        settings, config.replace(read_emulator(), changes)
    )
    # a shell's `&` makes SIGINT ignored
    for end in (signal.SIGINT, signal.SIGTERM):
        signal.signal(end, signal.default_int_handler)
    with contextlib.closing(servos.serve(options.link)) as terminal:
        print(terminal.name, flush=True)
        last = time.monotonic()
        try:
            while True:
                time.sleep(PERIOD)
                now = time.monotonic()
                servos.advance(now - last)
                last = now
        except KeyboardInterrupt:
            return 0


def _state(bus: Bus, joint: Joint) -> str:
    values = (
        bus.read(joint.id, "torque_enable")
        | bus.read(joint.id, "hardware_error_status")
        | bus.read(joint.id, "present_position", "present_temperature")
    )
    return (
        f"tendon {math.degrees(joint.tendon(values['present_position'])):.1f} deg, "
        f"{values['present_input_voltage'] * VOLTAGE_UNIT:.1f} V, "
        f"{values['present_temperature']} degC, "
        f"torque {'on' if values['torque_enable'] else 'off'}, "
        f"hardware errors: {hardware_errors(values['hardware_error_status'])}"
    )


def _open(settings: DynamixelSettings, baud: int | None = None) -> Bus:
    check_latency(settings.bus.port, settings.bus.latency_limit)
    port = SerialPort(
        settings.bus.port, baud or settings.bus.baud, settings.bus.timeout
    )
    port.open()
    return Bus(
        port,
        settings.bus,
        {joint.id: joint.name for joint in joints(settings.joints)},
    )


TOOLS: dict[str, Callable[[DynamixelSettings, argparse.Namespace], int]] = {
    "scan": scan,
    "info": info,
    "assign": assign,
    "prepare": prepare,
    "zero": zero,
    "emulate": emulate,
}
