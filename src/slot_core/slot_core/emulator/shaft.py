"""Motor, gear and heat of an emulated servo.

The motor follows its torque-speed line within motor_time, as `pid` does in dynamics/servo.py:

    motor_time dw/dt = w0 (v u - tau / tau_stall) - w

with the duty u, the supply voltage's share v of that of the data sheet and the load torque tau.
With torque off the gear holds up to `friction` and yields to more along the same line. Heat:

    C dT/dt = P_stall (torque / tau_stall)^2 - (T - T_room) / R

with time constant R C. `R`, `C`, `friction` are assumed, not measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from slot_core.config import quantity


@dataclass(frozen=True)
class ShaftSettings:
    """What `config/emulator.yaml` holds on the mechanism beside the motor of `servo.yaml`."""

    friction: float = quantity("torque that the gear holds with torque off", "N m", 0.0, 10.0)
    nominal_voltage: float = quantity("at which the motor's data hold", "V", 1.0, 20.0)
    stall_power: float = quantity("electric power at stall", "W", 0.0, 100.0)
    room: float = quantity("temperature around", "degC", -40.0, 60.0)
    thermal_resistance: float = quantity("motor to room", "K/W", 0.0, 100.0)
    thermal_time: float = quantity("time constant of the temperature", "s", 1.0, 1e5)


class Motor(NamedTuple):
    """The motor's line."""

    speed: float  # rad/s, without load
    stall: float  # N m
    time: float  # s


class Shaft:
    """State of the output shaft: angle (rad), speed (rad/s), temperature (degC)."""

    def __init__(self, motor: Motor, settings: ShaftSettings, angle: float) -> None:
        self.motor, self.settings = motor, settings
        self.angle, self.speed = angle, 0.0
        self.temperature = settings.room
        self.torque = 0.0  # N m, of the motor

    def advance(self, duty: float | None, load: float, voltage: float, h: float) -> None:
        """Move for h s under a duty (None: torque off) against a load torque (N m)."""
        target = self._target(duty, load, voltage / self.settings.nominal_voltage)
        self.speed += (target - self.speed) * (h / (self.motor.time + h))
        self.angle += h * self.speed
        self._heat(duty, voltage / self.settings.nominal_voltage, h)

    def _target(self, duty: float | None, load: float, supply: float) -> float:
        motor = self.motor
        if duty is not None:
            return motor.speed * (supply * duty - load / motor.stall)
        beyond = max(abs(load) - self.settings.friction, 0.0)
        return -motor.speed * math.copysign(beyond, load) / motor.stall

    def _heat(self, duty: float | None, supply: float, h: float) -> None:
        settings, motor = self.settings, self.motor
        share = 0.0 if duty is None else supply * duty - self.speed / motor.speed
        self.torque = share * motor.stall
        warm = settings.room + settings.thermal_resistance * settings.stall_power * share**2
        self.temperature += (warm - self.temperature) * (h / settings.thermal_time)
