"""Tendon angles, servo angles and counts of the encoder.

    servo = zero + direction ratio tendon,   counts = servo / (2 pi / 4096)

with the servo's angle at the relaxed tendon (`zero`), the side it pulls to and the ratio of the
angles. Legs in the order FL FR RL RR.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from slot_core.dynamixel.settings import JointSettings
from slot_core.dynamixel.table import COUNTS, PWM_FULL, RAD_PER_COUNT, RAD_S_PER_UNIT
from slot_core.robot import LEGS


@dataclass(frozen=True)
class Joint:
    """Conversion for one leg."""

    leg: str
    id: int
    zero: float  # rad, of the servo
    direction: int
    ratio: float  # servo's angle over tendon's
    low: float  # rad, of the tendon
    high: float
    margin: float  # rad, of the servo

    @property
    def name(self) -> str:
        """How messages call the servo."""
        return f"servo {self.leg} (id {self.id})"

    def counts(self, tendon: float) -> int:
        """Nearest count of the encoder to a tendon angle (rad)."""
        return round((self.zero + self.direction * self.ratio * tendon) / RAD_PER_COUNT)

    def tendon(self, counts: float) -> float:
        """Tendon angle (rad) at a count of the encoder."""
        return (counts * RAD_PER_COUNT - self.zero) / (self.direction * self.ratio)

    def tendon_rate(self, velocity: int) -> float:
        """Rate of the tendon angle (rad/s) from the register of the velocity."""
        return velocity * RAD_S_PER_UNIT / (self.direction * self.ratio)

    def tendon_torque(self, torque: float) -> float:
        """Torque on the tendon angle (N m) from one on the servo's, the power being the same."""
        return torque * self.direction * self.ratio

    def servo_torque(self, torque: float) -> float:
        """The inverse of `tendon_torque`."""
        return torque / (self.direction * self.ratio)

    def pwm(self, duty: float) -> int:
        """Register of the PWM for a duty in [-1, 1], positive when pulling."""
        return round(self.direction * duty * PWM_FULL)

    def limits(self) -> tuple[int, int]:
        """Position limits (counts) that the servo itself must keep: smallest, largest."""
        ends = [self.counts(self.low), self.counts(self.high)]
        margin = math.floor(self.margin / RAD_PER_COUNT)
        return min(ends) - margin, max(ends) + margin


def joints(settings: JointSettings) -> tuple[Joint, ...]:
    """The four joints; raises ValueError where the settings contradict each other."""
    if len(set(settings.ids)) < len(LEGS):
        raise ValueError(f"joints.ids = {settings.ids}: two servos with one id")
    if 0 in settings.direction:
        raise ValueError(f"joints.direction = {settings.direction}: expected 1 or -1")
    if settings.low_deg >= settings.high_deg:
        raise ValueError(
            f"joints.low_deg = {settings.low_deg}: not below high_deg = {settings.high_deg}"
        )
    found = tuple(_joint(settings, index) for index in range(len(LEGS)))
    for joint in found:
        low, high = joint.limits()
        if low < 0 or high >= COUNTS:
            raise ValueError(
                f"{joint.name}: its range, {low} to {high} counts, is not within one turn;"
                " fix the spool at another angle"
            )
    return found


def _joint(settings: JointSettings, index: int) -> Joint:
    return Joint(
        leg=LEGS[index],
        id=settings.ids[index],
        zero=math.radians(settings.zero_deg[index]),
        direction=settings.direction[index],
        ratio=settings.servo_per_tendon,
        low=math.radians(settings.low_deg),
        high=math.radians(settings.high_deg),
        margin=math.radians(settings.margin_deg),
    )
