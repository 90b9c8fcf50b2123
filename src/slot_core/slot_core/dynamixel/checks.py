"""Servos and configuration: checks of model, firmware and EEPROM, and the measured zero.

The zero of a servo is its angle with its tendon just slack.
"""

import math
import re
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from slot_core import config
from slot_core.dynamixel.bus import Bus, CommunicationError, InstructionError
from slot_core.dynamixel.settings import DynamixelSettings, Joint, joints
from slot_core.dynamixel.table import (
    ANSWER_ALL,
    BAUD_RATES,
    PWM_FULL,
    RAD_PER_COUNT,
    Mode,
)
from slot_core.faults import hardware_errors
from slot_core.refusal import read_text
from slot_core.robot import LEGS
from slot_core.servos.servo_bus import RefusedError

SAMPLES = 20
SAMPLE_PERIOD = 0.02  # s
ZERO_DIGITS = 2  # of a zero in deg
SPREAD_MAX = 3  # counts, largest spread of the readings of a servo at rest
NUMBER = r"-?\d+(?:\.\d+)?"

EEPROM = (  # first and last of adjacent registers
    ("id", "protocol_type"),
    ("homing_offset", "moving_threshold"),
    ("temperature_limit", "pwm_limit"),
    ("velocity_limit", "min_position_limit"),
    ("startup_configuration", "startup_configuration"),
    ("shutdown", "shutdown"),
)


@dataclass(frozen=True)
class ServoInfo:
    """Identity of a servo; `values`: its EEPROM by register name."""

    leg: str
    id: int
    model: int
    firmware: int
    values: Mapping[str, int]


def expected(settings: DynamixelSettings, joint: Joint) -> dict[str, int]:
    """EEPROM values that the configuration requires of a servo, by register name."""
    low, high = joint.limits()
    return settings.servo.eeprom() | {
        "operating_mode": settings.mode,
        "min_position_limit": low,
        "max_position_limit": high,
        "baud_rate": BAUD_RATES.index(settings.bus.baud),
    }


def examine(
    bus: Bus, settings: DynamixelSettings, joint: Joint
) -> tuple[ServoInfo | None, list[str]]:
    """Identity and EEPROM of a servo, and its differences from the configuration, one line each.

    None and the error if it does not answer. A status return level that another tool has left is
    set back: with it a servo does not confirm what it does.
    """
    try:
        bus.sync_write("status_return_level", {joint.id: ANSWER_ALL})
        model, firmware = bus.ping(joint.id)
        values = {
            name: value
            for first, last in EEPROM
            for name, value in bus.read(joint.id, first, last).items()
        }
    except (CommunicationError, InstructionError) as error:
        return None, [str(error)]
    setup, reasons = settings.servo, []
    if model != setup.model:
        reasons.append(f"{joint.name}: model {model}, expected {setup.model}")
    if firmware < setup.firmware_min:
        reasons.append(
            f"{joint.name}: firmware {firmware}, expected {setup.firmware_min} or newer"
        )
    reasons += [
        f"{joint.name}: {name} is {values[name]}, expected {value}; scripts/servos prepare"
        for name, value in expected(settings, joint).items()
        if values[name] != value
    ]
    return ServoInfo(joint.leg, joint.id, model, firmware, values), reasons


def misplaced(joint: Joint, present: int) -> list[str]:
    """One line if a servo stands outside of its limits, counts; none within."""
    low, high = joint.limits()
    if low <= present <= high:
        return []
    return [
        f"{joint.name}: stands at {present} counts, outside its limits [{low}, {high}];"
        " turn it back by hand, or zero it"
    ]


def prepare_torque(bus: Bus, settings: DynamixelSettings, joint: Joint) -> int:
    """Set goal := present position, gains, profile and watchdog; returns the position, counts.

    Raises ServoError, as RefusedError for an error or a position with which torque must stay off.
    """
    error = bus.read(joint.id, "hardware_error_status")["hardware_error_status"]
    if error:
        raise RefusedError(
            [
                f"{joint.name}: hardware error: {hardware_errors(error)};"
                f" scripts/operate reboot {joint.leg}, or the supply off and on"
            ]
        )
    bus.write_verified(joint.id, "torque_enable", 0)
    # a tripped one refuses goals
    bus.write_verified(joint.id, "bus_watchdog", 0)
    present = bus.read(joint.id, "present_position")["present_position"]
    if reasons := misplaced(joint, present):
        raise RefusedError(reasons)
    # Armed before torque comes on.
    bus.write_verified(joint.id, "bus_watchdog", settings.servo.watchdog_code())
    if settings.mode is Mode.PWM:
        bus.write_verified(joint.id, "goal_pwm", 0)
        return present
    for register, value in (
        ("goal_pwm", PWM_FULL),
        ("profile_acceleration", 0),
        ("profile_velocity", 0),
        ("feedforward_2nd_gain", 0),
        ("feedforward_1st_gain", 0),
        ("position_p_gain", settings.gains.p),
        ("position_i_gain", settings.gains.i),
        ("position_d_gain", settings.gains.d),
        ("goal_position", present),
    ):
        bus.write_verified(joint.id, register, value)
    return present


def measure_zero(
    bus: Bus, joint: Joint, sleep: Callable[[float], None]
) -> float:
    """Servo angle (deg), mean of SAMPLES readings with torque off.

    Rounded as in the configuration, since the servo's limits follow from it.

    Raises ServoError, also if the readings spread by more than SPREAD_MAX counts.
    """
    bus.write_verified(joint.id, "torque_enable", 0)
    found = []
    for _ in range(SAMPLES):
        found.append(bus.read(joint.id, "present_position")["present_position"])
        sleep(SAMPLE_PERIOD)
    moved = max(found) - min(found)
    if moved > SPREAD_MAX:
        raise RefusedError(
            [
                f"{joint.name}: moves by {moved} counts, limit {SPREAD_MAX}; hold it still"
            ]
        )
    return round(
        math.degrees(statistics.fmean(found) * RAD_PER_COUNT), ZERO_DIGITS
    )


def write_zero(leg: str, zero_deg: float) -> Path:
    """Write the zero of a leg (deg) into `config/dynamixel.yaml`; the rest of the file is kept.

    Returns the path of the file. Raises ConfigError, and writes nothing, if the file has no line
    `zero_deg` of four numbers or the value, or the servo's limits with it, are out of bounds.
    """
    path = config.config_dir() / "dynamixel.yaml"
    text = read_text(path, config.SIZE_MAX)
    line = re.search(
        rf"^(\s*zero_deg:\s*\[)({NUMBER}(?:\s*,\s*{NUMBER}){{3}})(\])",
        text,
        re.M,
    )
    if line is None:
        raise config.ConfigError(f"{path}: no line zero_deg: [FL, FR, RL, RR]")
    values = [value.strip() for value in line[2].split(",")]
    values[LEGS.index(leg)] = f"{zero_deg:.{ZERO_DIGITS}f}"
    changed = text[: line.start(2)] + ", ".join(values) + text[line.end(2) :]
    joints(
        config.build(DynamixelSettings, config.parse(changed), path.name).joints
    )
    path.write_text(changed)
    return path
