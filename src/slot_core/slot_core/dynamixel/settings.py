"""Settings of the servo bus, the servos on it and the two ways to control them.

Values: `config/dynamixel.yaml`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from slot_core import config
from slot_core.config import choice, quantity, text
from slot_core.dynamixel.table import (
    HARDWARE_ERROR_BITS,
    RETURN_DELAY_UNIT,
    VOLTAGE_UNIT,
    WATCHDOG_UNIT,
    Mode,
)

MODES = {"position": Mode.POSITION, "pwm": Mode.PWM}


@dataclass(frozen=True)
class BusSettings:
    """The serial line."""

    port: str = text("device, or a pseudo-terminal with emulated servos")
    baud: int = quantity("of the line and of all servos", "1/s", 9600, 4500000)
    latency_limit: int = quantity("largest latency timer of a USB port", "ms", 1, 255)
    timeout: float = quantity("for an answer, beyond its time on the wire", "s", 1e-4, 1.0)
    quiet: float = quantity("silence awaited after an answer that failed", "s", 0.0, 0.1)
    retries: int = quantity("further attempts to write or to read", "", 0, 10)
    window: int = quantity("exchanges over which error rates are taken", "", 10, 100000)


@dataclass(frozen=True)
class ServoSetup:
    """What every servo must be and how it is set up."""

    model: int = quantity("model number", "", 0, 65535)
    firmware_min: int = quantity("oldest firmware accepted", "", 0, 255)
    fast_from_firmware: int = quantity("oldest with fast sync read; 256: never", "", 0, 256)
    return_delay: float = quantity("before a servo answers", "s", 0.0, 508e-6)
    temperature_limit: int = quantity("above, the servo switches off", "degC", 0, 100)
    voltage_min: float = quantity("below, the servo switches off", "V", 6.0, 14.0)
    voltage_max: float = quantity("above, the servo switches off", "V", 6.0, 14.0)
    shutdown: int = quantity("hardware errors that switch it off", "", 0, HARDWARE_ERROR_BITS)
    watchdog: float = quantity("silence after which a servo stops", "s", 0.02, 2.54)

    def eeprom(self) -> dict[str, int]:
        """What the servos' EEPROM must hold, by register."""
        return {
            "drive_mode": 0,
            "secondary_id": 255,
            "protocol_type": 2,
            "homing_offset": 0,
            "startup_configuration": 0,
            "return_delay_time": round(self.return_delay / RETURN_DELAY_UNIT),
            "temperature_limit": self.temperature_limit,
            "min_voltage_limit": round(self.voltage_min / VOLTAGE_UNIT),
            "max_voltage_limit": round(self.voltage_max / VOLTAGE_UNIT),
            "shutdown": self.shutdown,
        }

    def watchdog_code(self) -> int:
        """Value of the bus watchdog's register, at least one unit."""
        return max(1, math.floor(self.watchdog / WATCHDOG_UNIT + 1e-9))


@dataclass(frozen=True)
class JointSettings:
    """From tendon angles to servo angles, FL FR RL RR; `joints.py` has the equations."""

    ids: tuple[int, int, int, int] = quantity("on the bus", "", 0, 252)
    zero_deg: tuple[float, float, float, float] = quantity(
        "servo's angle with the tendon relaxed", "deg", 0.0, 360.0
    )
    direction: tuple[int, int, int, int] = quantity("1: counts grow when pulling, or -1", "", -1, 1)
    servo_per_tendon: float = quantity("servo's angle over tendon's angle", "", 0.1, 10.0)
    low_deg: float = quantity("smallest tendon angle that is commanded", "deg", -10.0, 360.0)
    high_deg: float = quantity("largest tendon angle that is commanded", "deg", 0.0, 360.0)
    margin_deg: float = quantity("servo's own limits beyond these", "deg", 0.0, 45.0)
    speed_limit: float = quantity("of commanded tendon angles", "rad/s", 0.01, 100.0)


@dataclass(frozen=True)
class GainSettings:
    """Gains of the servo's own position loop, as its registers hold them."""

    p: int = quantity("position P gain", "1/128 step of duty per count", 0, 16383)
    i: int = quantity("position I gain", "1/65536", 0, 16383)
    d: int = quantity("position D gain", "1/16", 0, 16383)


@dataclass(frozen=True)
class HostPidSettings:
    """The position loop on the host; `host_pid.py` has the equations. Angles: tendon angles."""

    p: float = quantity("duty per angle", "1/rad", 0.0, 1e3)
    i: float = quantity("duty per angle and time", "1/(rad s)", 0.0, 1e4)
    d: float = quantity("duty per speed", "s/rad", 0.0, 1e2)
    filter_time: float = quantity("time constant of the measured speed", "s", 0.0, 1.0)
    duty_limit: float = quantity("largest duty", "", 0.0, 1.0)
    duty_rate: float = quantity("largest change of the duty", "1/s", 0.1, 1e4)
    blind_time: float = quantity("the duty is kept without a reading, then zero", "s", 0.0, 1.0)


@dataclass(frozen=True)
class DynamixelSettings:
    """What `config/dynamixel.yaml` holds."""

    bus: BusSettings
    servo: ServoSetup
    joints: JointSettings
    gains: GainSettings
    host_pid: HostPidSettings
    control: str = choice("who closes the loop: the servo, or the host in PWM mode", *MODES)

    @property
    def mode(self) -> Mode:
        """Operating mode of the servos."""
        return MODES[self.control]


def read_settings() -> DynamixelSettings:
    """The settings of `config/dynamixel.yaml`; raises ConfigError."""
    return config.read(DynamixelSettings, "dynamixel")
