"""Tools for Dynamixel servos on the bench; each returns its exit code."""

import argparse
import contextlib
import dataclasses
import math
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping

from slot_core import config
from slot_core.command_line import refuse
from slot_core.config import ConfigError
from slot_core.dynamixel.bus import Bus
from slot_core.dynamixel.checks import (
    examine,
    expected,
    measure_zero,
    misplaced,
    prepare_torque,
    write_zero,
)
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.emulator.emulated_legs import EmulatedDynamixels
from slot_core.dynamixel.emulator.emulated_servo import Memory
from slot_core.dynamixel.port import BaudRateError, SerialPort, check_latency
from slot_core.dynamixel.settings import (
    DynamixelSettings,
    Joint,
    joints,
    read_settings,
)
from slot_core.dynamixel.table import (
    BAUD_RATES,
    TABLE,
    VOLTAGE_UNIT,
    Mode,
)
from slot_core.faults import BUS_KINDS, Fault, hardware_errors
from slot_core.robot import LEGS
from slot_core.servos.servo_bus import RefusedError, ServoError

PERIOD = 0.002  # s, between two steps of the emulated servos
FAILED = 1  # exit code
SPOOL = "spool"
STEP = 0.02  # s, between two goals of `move`
SETTLE = 15  # goals, until the leg is where it goes
RATE_MAX = 60.0  # deg/s, of `move`
NO_ANSWER = "no servo answered: check power, cable and port"
ALONE = (
    "a new servo has id 1 at 57600 baud, two with one id answer at once:"
    " connect it alone, then scripts/servos --baud RATE assign ID"
)


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
    found = 0
    for baud, identity, model, firmware in _answers(settings, options.baud):
        print(
            f"{baud:>8} baud  id {identity:>3}  model {model}  firmware {firmware}"
        )
        found += 1
    if not found:
        print(NO_ANSWER, file=sys.stderr)
    return 0 if found else FAILED


def _answers(
    settings: DynamixelSettings, only: int | None = None
) -> Iterator[tuple[int, int, int, int]]:
    """Baud rate, id, model and firmware of each servo that answers, at all rates or `only` one."""
    for baud in [only] if only else sorted(BAUD_RATES, reverse=True):
        try:
            bus = _open(settings, baud)
        except BaudRateError:
            continue
        for identity, (model, firmware) in bus.scan().items():
            yield baud, identity, model, firmware
        bus.port.close()


def info(settings: DynamixelSettings, options: argparse.Namespace) -> int:
    """Print the four servos' state, what is wrong with it, and what mends it; exit code 0: nothing."""
    bus, silent, wrong = _open(settings), False, False
    for joint in joints(settings.joints):
        found, reasons = examine(bus, settings, joint)
        silent |= found is None
        if found is not None:
            values = (
                bus.read(joint.id, "torque_enable")
                | bus.read(joint.id, "hardware_error_status")
                | bus.read(joint.id, "present_position", "present_temperature")
            )
            print(
                f"{joint.name}: model {found.model}, firmware {found.firmware}\n"
                f"  tendon {math.degrees(joint.tendon(values['present_position'])):z.1f} deg, "
                f"{values['present_input_voltage'] * VOLTAGE_UNIT:.1f} V, "
                f"{values['present_temperature']} degC, "
                f"torque {'on' if values['torque_enable'] else 'off'}, "
                f"hardware errors: {hardware_errors(values['hardware_error_status'])}"
            )
            # limits and direction of another tool would misplace it
            reasons = reasons or misplaced(joint, values["present_position"])
            reasons += _complaints(settings, joint, values)
        for reason in reasons:
            print(f"  {reason}")
        wrong |= bool(reasons)
    if silent:
        bus.port.close()
        there = [f"id {i} at {baud} baud" for baud, i, *_ in _answers(settings)]
        print(f"answers: {', '.join(there)}; {ALONE}" if there else NO_ANSWER)
    return FAILED if wrong else 0


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
    """Write the configuration into the EEPROM of the servos there, where it differs; torque off."""
    bus, absent = _open(settings), list[str]()
    for joint in joints(settings.joints):
        found, _ = examine(bus, settings, joint)
        if found is None:
            absent.append(joint.name)
            continue
        bus.write_verified(joint.id, "torque_enable", 0)
        for name, value in expected(settings, joint).items():
            if found.values[name] != value:
                bus.write_verified(joint.id, name, value)
                print(f"{joint.name}: {name} {found.values[name]} -> {value}")
        _, remaining = examine(bus, settings, joint)
        if remaining:
            raise RefusedError(remaining)
    if absent:
        print(
            f"no answer: {', '.join(absent)}; prepare again once they are there"
        )
    return FAILED if len(absent) == len(LEGS) else 0


def zero(settings: DynamixelSettings, options: argparse.Namespace) -> int:
    """Measure the zero of a leg at its present position; optionally write it."""
    joint = joints(settings.joints)[LEGS.index(options.leg)]
    angle = measure_zero(_open(settings), joint, time.sleep)
    print(
        f"{joint.name}: zero at {angle:.2f} deg,"
        f" {math.degrees(joint.zero):.2f} deg before"
        f"{'' if options.write else '; not written without --write'}"
    )
    if options.write:
        print(
            f"written to {write_zero(options.leg, angle)}; now run scripts/servos prepare"
        )
    return 0


def move(settings: DynamixelSettings, options: argparse.Namespace) -> int:
    """Move the tendon of one leg to an angle and back, at a rate; torque off before and after."""
    joint = joints(settings.joints)[LEGS.index(options.leg)]
    low, high = math.degrees(joint.low), math.degrees(joint.high)
    for name, value, least, most in (
        ("ANGLE", options.angle, low, high),
        ("--rate", options.rate, 0.1, RATE_MAX),
    ):
        if not least <= value <= most:
            raise ConfigError(
                f"{name} {value:g}: outside [{least:g}, {most:g}]"
            )
    if settings.mode is not Mode.POSITION:
        raise ConfigError(
            "control = pwm: a leg moves alone with control: position of dynamixel.yaml"
        )
    bus = _open(settings)
    _, reasons = examine(bus, settings, joint)
    if reasons:
        raise RefusedError(reasons)
    start = joint.tendon(prepare_torque(bus, settings, joint))
    goal = math.radians(options.angle)
    steps = math.ceil(abs(goal - start) / math.radians(options.rate) / STEP)
    way = [start + (goal - start) * k / max(steps, 1) for k in range(steps + 1)]
    try:
        bus.write_verified(joint.id, "torque_enable", 1)
        for name, angles in (("there", way), ("back", way[::-1])):
            for angle in [*angles, *SETTLE * angles[-1:]]:
                bus.write(joint.id, "goal_position", joint.counts(angle))
                time.sleep(STEP)
            present = bus.read(joint.id, "present_position")["present_position"]
            print(
                f"{joint.name}: {name}: at {math.degrees(joint.tendon(present)):z.1f} deg,"
                f" goal {math.degrees(angles[-1]):z.1f} deg",
                flush=True,
            )
    finally:
        # an interrupt may have left an exchange unfinished
        bus.port.is_using = False
        bus.write_verified(joint.id, "torque_enable", 0)
    return 0


def emulate(settings: DynamixelSettings, options: argparse.Namespace) -> int:
    """Serve emulated servos on a pseudo-terminal until interrupted."""
    servos = emulated(settings, options)
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


def emulated(
    settings: DynamixelSettings, options: argparse.Namespace
) -> EmulatedDynamixels:
    """Four configured servos with relaxed tendons, new and with faults as the options say."""
    latency = options.usb_latency
    changes = {} if latency is None else {"usb_latency": latency}
    servos = EmulatedDynamixels(
        settings, config.replace(read_emulator(), changes)
    )
    for leg, servo in zip(LEGS, servos.bus.servos):
        if options.new == leg:
            servo.memory = Memory()
        elif options.new:
            servos.set_fault(Fault("silent", leg, 0.0, 0.0, 0.0), on=True)
    for text in options.fault:
        disturb(servos, text)
    return servos


def disturb(servos: EmulatedDynamixels, text: str) -> None:
    """Apply KIND:LEG[:VALUE]: the angle of a spool (deg), a register, or a fault as injected."""
    kind, leg, value = (*text.split(":"), "0", "0")[:3]
    if leg not in LEGS:
        raise ConfigError(
            f"--fault {text}: expected KIND:LEG or KIND:LEG:VALUE"
        )
    index, number = LEGS.index(leg), float(value)
    servo, register = servos.bus.servos[index], TABLE.get(kind)
    if register is not None and not register.low <= number <= register.high:
        raise ConfigError(
            f"--fault {text}: outside [{register.low}, {register.high}]"
        )
    if register is not None:
        servo.memory[kind] = int(number)
    elif kind == SPOOL:
        servo.shaft.angle = servos.joints[index].servo_angle(
            math.radians(number)
        )
    elif kind in BUS_KINDS:
        servos.set_fault(Fault(kind, leg, 0.0, 0.0, number), on=True)
    else:
        raise ConfigError(
            f"--fault {text}: expected {SPOOL}, a register, or one of {', '.join(BUS_KINDS)}"
        )


def _complaints(
    settings: DynamixelSettings, joint: Joint, values: Mapping[str, int]
) -> Iterator[str]:
    """Lines on a state with which the servo would not come under torque, or not for long."""
    if errors := values["hardware_error_status"]:
        yield f"{joint.name}: {hardware_errors(errors)}: mend the cause, then switch the supply off and on"
    voltage = values["present_input_voltage"] * VOLTAGE_UNIT
    low, high = settings.servo.voltage_min, settings.servo.voltage_max
    if not low <= voltage <= high:
        yield f"{joint.name}: {voltage:.1f} V, limits [{low:g}, {high:g}] V: check supply and cable"


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
    "move": move,
    "emulate": emulate,
}
