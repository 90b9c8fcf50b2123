"""Settings of the servo bus, the servos on it and their position control.

Values: `config/dynamixel.yaml`.
"""

import math
from dataclasses import dataclass

from slot_core import config
from slot_core.config import ConfigError, choice, quantity, text
from slot_core.dynamixel.table import (
    BAUD_RATES,
    COUNTS,
    NO_SECONDARY_ID,
    PWM_FULL,
    RAD_PER_COUNT,
    RAD_S_PER_UNIT,
    RETURN_DELAY_UNIT,
    TABLE,
    VOLTAGE_UNIT,
    WATCHDOG_UNIT,
    Mode,
)
from slot_core.faults import HARDWARE_ERROR_BITS
from slot_core.robot import LEGS

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
    """Conversion from tendon to servo angles and encoder counts, FL FR RL RR.

        servo = zero + direction ratio tendon,   counts = servo / (2 pi / 4096)

    `zero`: servo angle with the tendon relaxed; `direction`: 1 if the servo angle grows when
    pulling, else -1; `ratio`: servo angle per tendon angle.
    """

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


@dataclass(frozen=True)
class Joint:
    """Conversion for the servo of one leg."""

    leg: str
    id: int
    zero: float  # rad, servo angle
    direction: int
    ratio: float  # servo angle per tendon angle
    low: float  # rad, smallest tendon angle commanded
    high: float  # rad, largest tendon angle commanded
    margin: float  # rad of servo angle, distance of the servo's own limits beyond these

    @property
    def name(self) -> str:
        """Name of the servo in messages."""
        return f"servo {self.leg} (id {self.id})"

    def servo_angle(self, tendon: float) -> float:
        """Angle of the servo (rad) at a tendon angle (rad)."""
        return self.zero + self.direction * self.ratio * tendon

    def tendon_angle(self, servo: float) -> float:
        """Tendon angle (rad) at an angle of the servo (rad)."""
        return (servo - self.zero) / (self.direction * self.ratio)

    def counts(self, tendon: float) -> int:
        """Encoder count nearest to a tendon angle (rad)."""
        return round(self.servo_angle(tendon) / RAD_PER_COUNT)

    def tendon(self, counts: float) -> float:
        """Tendon angle (rad) at an encoder count."""
        return self.tendon_angle(counts * RAD_PER_COUNT)

    def tendon_rate(self, velocity: int) -> float:
        """Tendon angle rate (rad/s) from the value of Present Velocity."""
        return velocity * RAD_S_PER_UNIT / (self.direction * self.ratio)

    def servo_torque(self, torque: float) -> float:
        """Torque on the servo angle (N m) from the torque on the tendon angle, at equal power."""
        return torque / (self.direction * self.ratio)

    def pwm(self, duty: float) -> int:
        """Value of Goal PWM for a duty in [-1, 1], positive when pulling."""
        return round(self.direction * duty * PWM_FULL)

    def limits(self) -> tuple[int, int]:
        """Min and Max Position Limit of the servo (counts): the commanded range plus the margin."""
        ends = [self.counts(self.low), self.counts(self.high)]
        margin = math.floor(self.margin / RAD_PER_COUNT)
        return min(ends) - margin, max(ends) + margin


def joints(settings: JointSettings) -> tuple[Joint, ...]:
    """The four joints.

    Raises ConfigError for two equal ids, a direction of 0, an empty range of tendon angles, or
    position limits that are not within one turn of the encoder.
    """
    if len(set(settings.ids)) < len(LEGS):
        raise ConfigError(
            f"dynamixel.yaml: joints.ids = {settings.ids}: two servos with one id"
        )
    if 0 in settings.direction:
        raise ConfigError(
            f"dynamixel.yaml: joints.direction = {settings.direction}: expected 1 or -1"
        )
    if settings.low_deg >= settings.high_deg:
        raise ConfigError(
            f"dynamixel.yaml: joints.low_deg = {settings.low_deg}: not below high_deg ="
            f" {settings.high_deg}"
        )
    found = tuple(
        Joint(
            leg=leg,
            id=settings.ids[index],
            zero=math.radians(settings.zero_deg[index]),
            direction=settings.direction[index],
            ratio=settings.servo_per_tendon,
            low=math.radians(settings.low_deg),
            high=math.radians(settings.high_deg),
            margin=math.radians(settings.margin_deg),
        )
        for index, leg in enumerate(LEGS)
    )
    for joint in found:
        low, high = joint.limits()
        if low < 0 or high >= COUNTS:
            raise ConfigError(
                f"dynamixel.yaml: {joint.name}: its range, {low} to {high} counts, is not within"
                " one turn; mount the spool at another angle"
            )
    return found
