"""The servo of a tendon: a position loop whose speed the load bounds.

The loop turns the spool at (command - angle) / lag. `torque_speed` bounds it by the line of a DC
motor at full voltage, with load torque tau = r_spool T pulling back:

    -w0 (1 + tau / tau_stall) <= rate <= w0 (1 - tau / tau_stall)

(ROBOTIS XL430-W250: 1.4 N m stall, 57 rpm no load at 11.1 V). `ideal` bounds the rate only.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from slot_core import config
from slot_core.config import choice, quantity
from slot_core.dynamics.compiled import helper


@dataclass(frozen=True)
class ServoSettings:
    """What `config/servo.yaml` holds on the servo as a mechanism."""

    model: str = choice("how the load bounds the speed", "torque_speed", "ideal")
    lag: float = quantity("time constant of the position loop", "s", 1e-3, 1.0)
    stall_torque: float = quantity("torque at rest and full voltage", "N m", 0.01, 100.0)
    no_load_rpm: float = quantity("speed without load", "rev/min", 1.0, 1000.0)
    ideal_rpm: float = quantity("largest speed of the ideal servo", "rev/min", 1.0, 1000.0)


class Servo(NamedTuple):
    """Numbers of the servo's law."""

    gain: float  # 1/s
    speed: float  # rad/s
    yielding: float  # 1/(N m), relative loss of speed per torque


def read_servo() -> ServoSettings:
    """The servo of `config/servo.yaml`; raises ConfigError."""
    return config.read(ServoSettings, "servo")


def servo(settings: ServoSettings) -> Servo:
    """Numbers for the kernel."""
    ideal = settings.model == "ideal"
    rpm = settings.ideal_rpm if ideal else settings.no_load_rpm
    return Servo(
        gain=1.0 / settings.lag,
        speed=rpm * math.tau / 60.0,
        yielding=0.0 if ideal else 1.0 / settings.stall_torque,
    )


@helper
def turning_rate(law, command, angle, torque):
    """Rate of the tendon angle, rad/s, positive when pulling."""
    rate = law.gain * (command - angle)
    upper = law.speed * (1.0 - law.yielding * torque)
    lower = -law.speed * (1.0 + law.yielding * torque)
    return min(max(rate, lower), upper)
