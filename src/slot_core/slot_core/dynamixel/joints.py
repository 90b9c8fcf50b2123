"""Conversion between tendon angle, servo angle and encoder counts.

    servo = zero + direction ratio tendon,   counts = servo / (2 pi / 4096)

`zero`: servo angle with the tendon relaxed; `direction`: 1 if the servo angle grows when pulling,
else -1; `ratio`: servo angle per tendon angle. Legs in the order FL FR RL RR.
"""

import math
from dataclasses import dataclass

from slot_core.config import ConfigError
from slot_core.dynamixel.settings import JointSettings
from slot_core.dynamixel.table import (
    COUNTS,
    PWM_FULL,
    RAD_PER_COUNT,
    RAD_S_PER_UNIT,
)
from slot_core.robot import LEGS


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
