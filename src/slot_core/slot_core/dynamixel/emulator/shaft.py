"""Motor, gear and temperature of an emulated servo.

The motor's speed follows its torque-speed line with time constant motor_time, as `pid` does in
`dynamics/servo.py`:

    motor_time dw/dt = w0 (v u - tau / tau_stall) - w

with the duty u and the load torque tau; w0 and tau_stall of `servo.yaml` hold at the supply
voltage V of the servos, v is 1 but while a fault gives a servo another voltage, v V. With torque
off the gear holds loads up to `friction`; the excess turns it along the same line, u = 0.
Temperature:

    C dT/dt = (V torque / tau_stall)^2 / R_el - (T - T_room) / R

with time constant R C, the motor's torque and its electric resistance R_el. `R`, `C`, `friction`
are assumed, not measured.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from slot_core.config import quantity


@dataclass(frozen=True)
class ShaftSettings:
    """Gear and heat; the motor itself is in `servo.yaml`."""

    friction: float = quantity(
        "load torque that the gear holds with torque off", "N m", 0.0, 10.0
    )
    resistance: float = quantity(
        "electric resistance of the motor at stall", "ohm", 0.1, 1e3
    )
    room: float = quantity("room temperature", "degC", -40.0, 60.0)
    thermal_resistance: float = quantity(
        "thermal resistance from motor to room", "K/W", 0.0, 100.0
    )
    thermal_time: float = quantity(
        "time constant of the temperature", "s", 1.0, 1e5
    )


class Motor(NamedTuple):
    """Torque-speed line at a supply voltage, and time constant of the motor."""

    voltage: float  # V
    speed: float  # rad/s, no-load speed
    stall: float  # N m, stall torque
    time: float  # s, time constant of the speed


class Shaft:
    """Output shaft: angle (rad), speed (rad/s), motor torque (N m), temperature (degC)."""

    def __init__(
        self, motor: Motor, settings: ShaftSettings, angle: float
    ) -> None:
        self.motor, self.settings = motor, settings
        self.angle, self.speed = angle, 0.0
        self.temperature = settings.room
        self.torque = 0.0

    def advance(
        self, duty: float | None, load: float, voltage: float, h: float
    ) -> None:
        """Advance by h s at a duty (None: torque off), supply voltage (V) and load torque (N m).

        A positive load lowers the angle.
        """
        supply = voltage / self.motor.voltage
        self.speed += (self._target(duty, load, supply) - self.speed) * (
            h / (self.motor.time + h)
        )
        self.angle += h * self.speed
        self._heat(duty, supply, h)

    def _target(self, duty: float | None, load: float, supply: float) -> float:
        motor = self.motor
        if duty is not None:
            return motor.speed * (supply * duty - load / motor.stall)
        excess = max(abs(load) - self.settings.friction, 0.0)
        return -motor.speed * math.copysign(excess, load) / motor.stall

    def _heat(self, duty: float | None, supply: float, h: float) -> None:
        settings, motor = self.settings, self.motor
        share = (
            0.0 if duty is None else supply * duty - self.speed / motor.speed
        )
        self.torque = share * motor.stall
        power = (motor.voltage * share) ** 2 / settings.resistance
        steady = settings.room + settings.thermal_resistance * power
        self.temperature += (steady - self.temperature) * (
            h / settings.thermal_time
        )
