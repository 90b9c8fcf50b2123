"""Settings of the servo bus, the servos on it and their position control.

Values: `config/dynamixel.yaml`.
"""

import math
from dataclasses import dataclass

from slot_core import config
from slot_core.config import ConfigError, choice, quantity, text
from slot_core.dynamixel.table import (
    BAUD_RATES,
    NO_SECONDARY_ID,
    PWM_FULL,
    RETURN_DELAY_UNIT,
    TABLE,
    VOLTAGE_UNIT,
    WATCHDOG_UNIT,
    Mode,
)
from slot_core.faults import HARDWARE_ERROR_BITS

MODES = {"position": Mode.POSITION, "pwm": Mode.PWM}


@dataclass(frozen=True)
class BusSettings:
    """Serial line."""

    port: str = text("device, or the pseudo-terminal of emulated servos")
    baud: int = quantity(
        "baud rate of the line and of all servos", "1/s", 9600, 4500000
    )
    latency_limit: int = quantity(
        "largest latency timer accepted of a USB port", "ms", 1, 255
    )
    timeout: float = quantity(
        "timeout of an answer, beyond its transmission time", "s", 1e-4, 1.0
    )
    quiet: float = quantity(
        "idle time of the line awaited after an invalid answer", "s", 0.0, 0.1
    )
    retries: int = quantity("retries of a write or a read", "", 0, 10)
    window: int = quantity(
        "exchanges over which error rates are taken", "", 10, 100000
    )

    def __post_init__(self) -> None:
        """Raise ConfigError for a baud rate that the servos do not have."""
        if self.baud not in BAUD_RATES:
            raise ConfigError(
                f"bus.baud = {self.baud}: expected one of"
                f" {', '.join(map(str, BAUD_RATES))}"
            )


@dataclass(frozen=True)
class ServoSetup:
    """Model, firmware and EEPROM that every servo must have."""

    model: int = quantity("model number", "", 0, 65535)
    firmware_min: int = quantity("oldest firmware accepted", "", 0, 255)
    fast_from_firmware: int = quantity(
        "oldest with fast sync read; 256: never", "", 0, 256
    )
    return_delay: float = quantity(
        "delay of a servo's answer", "s", 0.0, 508e-6
    )
    temperature_limit: int = quantity(
        "overheating error above this", "degC", 0, 100
    )
    voltage_min: float = quantity(
        "input voltage error below this", "V", 6.0, 14.0
    )
    voltage_max: float = quantity(
        "input voltage error above this", "V", 6.0, 14.0
    )
    shutdown: int = quantity(
        "hardware errors that switch torque off", "", 0, HARDWARE_ERROR_BITS
    )
    watchdog: float = quantity(
        "time without an instruction until it stops", "s", 0.02, 2.54
    )

    def eeprom(self) -> dict[str, int]:
        """EEPROM values that are the same for all servos, by register name."""
        return {
            "drive_mode": 0,
            "secondary_id": NO_SECONDARY_ID,
            "protocol_type": 2,
            "homing_offset": 0,
            "startup_configuration": 0,
            "return_delay_time": round(self.return_delay / RETURN_DELAY_UNIT),
            "temperature_limit": self.temperature_limit,
            "min_voltage_limit": round(self.voltage_min / VOLTAGE_UNIT),
            "max_voltage_limit": round(self.voltage_max / VOLTAGE_UNIT),
            "pwm_limit": PWM_FULL,
            "velocity_limit": TABLE["velocity_limit"].initial,
            "shutdown": self.shutdown,
        }

    def watchdog_code(self) -> int:
        """Value of Bus Watchdog: `watchdog` rounded down to units of 20 ms, at least 1."""
        return max(1, math.floor(self.watchdog / WATCHDOG_UNIT + 1e-9))


@dataclass(frozen=True)
class JointSettings:
    """Conversion from tendon to servo angles, FL FR RL RR; equations: `joints.py`."""

    ids: tuple[int, int, int, int] = quantity("servo ids", "", 0, 252)
    zero_deg: tuple[float, float, float, float] = quantity(
        "servo angle with the tendon relaxed", "deg", 0.0, 360.0
    )
    direction: tuple[int, int, int, int] = quantity(
        "1 or -1: sign of counts when pulling", "", -1, 1
    )
    servo_per_tendon: float = quantity(
        "servo angle per tendon angle", "", 0.1, 10.0
    )
    low_deg: float = quantity(
        "smallest tendon angle commanded", "deg", -10.0, 360.0
    )
    high_deg: float = quantity(
        "largest tendon angle commanded", "deg", 0.0, 360.0
    )
    margin_deg: float = quantity(
        "margin of the servo's own limits, servo angle", "deg", 0.0, 45.0
    )


@dataclass(frozen=True)
class GainSettings:
    """Gains of the servo's own position loop, as register values."""

    p: int = quantity(
        "position P gain", "1/128 step of duty per count", 0, 16383
    )
    i: int = quantity("position I gain", "1/65536", 0, 16383)
    d: int = quantity("position D gain", "1/16", 0, 16383)


@dataclass(frozen=True)
class HostPidSettings:
    """Position PID on the host, of tendon angles; equations: `driver.py`."""

    p: float = quantity("P gain, duty per angle", "1/rad", 0.0, 1e3)
    i: float = quantity(
        "I gain, duty per angle and time", "1/(rad s)", 0.0, 1e4
    )
    d: float = quantity("D gain, duty per speed", "s/rad", 0.0, 1e2)
    filter_time: float = quantity(
        "time constant of the filter of the speed", "s", 0.0, 1.0
    )
    duty_limit: float = quantity("largest duty", "", 0.0, 1.0)
    duty_rate: float = quantity(
        "largest rate of change of the duty", "1/s", 0.1, 1e4
    )
    blind_time: float = quantity(
        "time without a reading until the duty is 0", "s", 0.0, 1.0
    )


@dataclass(frozen=True)
class DynamixelSettings:
    """Contents of `config/dynamixel.yaml`."""

    bus: BusSettings
    servo: ServoSetup
    joints: JointSettings
    gains: GainSettings
    host_pid: HostPidSettings
    control: str = choice(
        "position loop: of the servo, or of the host in PWM mode", *MODES
    )

    @property
    def mode(self) -> Mode:
        """Operating mode of the servos."""
        return MODES[self.control]


def read_settings() -> DynamixelSettings:
    """The settings of `config/dynamixel.yaml`; raises ConfigError."""
    return config.read(DynamixelSettings, "dynamixel")
