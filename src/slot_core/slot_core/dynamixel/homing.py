"""Homing: the zero of a servo, measured with its tendon just slack, and its configuration."""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Callable
from pathlib import Path

from slot_core import config
from slot_core.dynamixel.bus import Bus
from slot_core.dynamixel.joints import Joint, joints
from slot_core.dynamixel.settings import DynamixelSettings
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.refusal import read_text
from slot_core.robot import LEGS
from slot_core.servos.servo_errors import RefusedError

Sleep = Callable[[float], None]
SAMPLES = 20
SAMPLE_PERIOD = 0.02  # s
ZERO_DIGITS = 2  # of a zero in deg
SPREAD_MAX = 3  # counts, largest spread of the readings of a servo at rest
NUMBER = r"-?\d+(?:\.\d+)?"


def measure_zero(bus: Bus, joint: Joint, sleep: Sleep) -> float:
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
    return round(math.degrees(statistics.fmean(found) * RAD_PER_COUNT), ZERO_DIGITS)


def write_zero(leg: str, zero_deg: float) -> Path:
    """Write the zero of a leg (deg) into `config/dynamixel.yaml`; the rest of the file is kept.

    Returns the path of the file. Raises ConfigError, and writes nothing, if the file has no line
    `zero_deg` of four numbers or the value, or the servo's limits with it, are out of bounds.
    """
    path = config.config_dir() / "dynamixel.yaml"
    text = read_text(path, config.SIZE_MAX)
    line = re.search(
        rf"^(\s*zero_deg:\s*\[)({NUMBER}(?:\s*,\s*{NUMBER}){{3}})(\])", text, re.M
    )
    if line is None:
        raise config.ConfigError(f"{path}: no line zero_deg: [FL, FR, RL, RR]")
    values = [value.strip() for value in line[2].split(",")]
    values[LEGS.index(leg)] = f"{zero_deg:.{ZERO_DIGITS}f}"
    changed = text[: line.start(2)] + ", ".join(values) + text[line.end(2) :]
    settings = config.build(DynamixelSettings, config.parse(changed), path.name)
    joints(settings.joints)
    path.write_text(changed)
    return path
