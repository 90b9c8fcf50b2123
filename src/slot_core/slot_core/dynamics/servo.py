"""The servo of a tendon: a position loop with a speed limited by the load.

`torque_speed` turns the spool at (command - angle) / lag, within the line of a DC motor at the full
supply voltage, with load torque tau = r_spool T pulling back:

    -w0 (1 + tau / tau_stall) <= rate <= w0 (1 - tau / tau_stall)

w0 and tau_stall are the maker's figures at the scene's supply voltage, linear between those that
the maker states (at the shaft, which turns servo_per_tendon times as far as the tendon angle).
`ideal` limits the rate only, whatever the voltage. `pid` is the loop inside the servo: duty, a
share of the supply voltage, u = clip(k_p e + k_i int e dt - k_d w, -1, 1) with e = command - angle;
the integral is held while the duty is saturated (anti-windup); the motor approaches its line with
the time constant motor_time: motor_time dw/dt = w0 (u - tau / tau_stall) - w.

Backlash: the spool lies within half of it on either side of the motor, and a taut tendon pulls it
to the lower side. The encoder, and with it the loop, measures the spool.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.compiled import helper
from slot_core.config import ConfigError, choice, quantity
from slot_core.dynamics.lanes import like, where
from slot_core.matrices import interpolated
from slot_core.robot import read_parameters


@dataclass(frozen=True)
class ServoSettings:
    """Mechanical model of the servo, from `config/servo.yaml`."""

    model: str = choice(
        "model of the position loop", "torque_speed", "ideal", "pid"
    )
    lag: float = quantity("time constant of the position loop", "s", 1e-3, 1.0)
    voltage: tuple[float, ...] = quantity(
        "supply voltages for which the maker states stall torque and speed, rising",
        "V",
        1.0,
        60.0,
    )
    stall_torque: tuple[float, ...] = quantity(
        "stall torque at each of these voltages, at the shaft",
        "N m",
        0.01,
        100.0,
    )
    no_load_rpm: tuple[float, ...] = quantity(
        "no-load speed of the shaft at each of these voltages",
        "rev/min",
        1.0,
        1000.0,
    )
    nominal_voltage: float = quantity(
        "supply voltage assumed where none is known", "V", 1.0, 60.0
    )
    continuous_load: float = quantity(
        "largest share of the stall torque that the maker advises for continuous use",
        "",
        0.0,
        1.0,
    )
    ideal_rpm: float = quantity(
        "maximum speed of the ideal servo's shaft", "rev/min", 1.0, 1000.0
    )
    servo_per_tendon: float = quantity(
        "angle of the shaft per tendon angle", "", 0.1, 10.0
    )
    proportional: float = quantity(
        "P gain of the pid: duty per angle", "1/rad", 0.0, 1e3
    )
    integral: float = quantity(
        "I gain of the pid: duty per angle and time", "1/(rad s)", 0.0, 1e4
    )
    derivative: float = quantity(
        "D gain of the pid: duty per speed", "s/rad", 0.0, 1e2
    )
    motor_time: float = quantity(
        "time constant of the motor driven by the pid", "s", 0.0, 1.0
    )
    backlash_deg: float = quantity(
        "play between motor and spool", "deg", 0.0, 10.0
    )

    def __post_init__(self) -> None:
        """Raise ConfigError unless the voltages rise and each has its torque and speed."""
        if not self.voltage or any(
            low >= high for low, high in pairwise(self.voltage)
        ):
            raise ConfigError(
                f"voltage = {list(self.voltage)}: expected rising values"
            )
        for name in ("stall_torque", "no_load_rpm"):
            values = getattr(self, name)
            if len(values) != len(self.voltage):
                raise ConfigError(
                    f"{name} = {list(values)}: expected {len(self.voltage)} values, one for each"
                    " voltage"
                )

    def require_voltage(self, voltage: float) -> None:
        """Raise ConfigError for a supply voltage (V) beyond those that the maker states."""
        low, high = self.voltage[0], self.voltage[-1]
        if not low <= voltage <= high:
            raise ConfigError(
                f"supply_voltage = {voltage}: outside [{low}, {high}] V, the voltages of servo.yaml"
            )

    def stall(self, voltage: float | Array) -> Array:
        """Stall torque of the shaft at supply voltages (V), N m."""
        return self._at(voltage, self.stall_torque)

    def speed(self, voltage: float | Array) -> Array:
        """No-load speed of the shaft at supply voltages (V), rad/s."""
        return self._at(voltage, self.no_load_rpm) * math.tau / 60.0

    def tendon_stall(self, voltage: float | Array) -> Array:
        """Stall torque on the tendon angle at supply voltages (V), N m."""
        return self.stall(voltage) * self.servo_per_tendon

    def tendon_speed(self, voltage: float | Array) -> Array:
        """Largest rate of the tendon angle without load at supply voltages (V), rad/s."""
        return self.speed(voltage) / self.servo_per_tendon

    def _at(self, voltage: float | Array, figures: tuple[float, ...]) -> Array:
        """The maker's figures at supply voltages, linear in between.

        Beyond the stated voltages the figures of the nearest one; at NaN those at the nominal one.
        """
        known = np.where(np.isnan(voltage), self.nominal_voltage, voltage)
        return np.asarray(interpolated(known, self.voltage, figures))


class Servo(NamedTuple):
    """Parameters of the servo model for the kernels."""

    gain: float  # 1/s
    speed: float  # rad/s
    # 1/(N m), relative loss of speed per torque, 1 / tau_stall
    speed_loss: float
    pid: bool
    proportional: float  # 1/rad
    integral: float  # 1/(rad s)
    derivative: float  # s/rad
    motor_time: float  # s
    play: float  # rad, half the backlash
    # load on the spool over the load without friction, while it winds
    friction: float = 1.0


def read_servo(parameters: str = "") -> ServoSettings:
    """The servo of `config/servo.yaml`, changed by a set of `config/parameters` if one is named.

    Raises ConfigError.
    """
    settings = config.read(ServoSettings, "servo")
    if not parameters:
        return settings
    return config.replace(
        settings, read_parameters(parameters, "servo"), f"{parameters}: servo"
    )


def servo(settings: ServoSettings, voltage: float) -> Servo:
    """Parameters of the servo model at a supply voltage (V), in SI units.

    Raises ConfigError for a voltage beyond those that the maker states.
    """
    settings.require_voltage(voltage)
    ideal = settings.model == "ideal"
    rate = settings.ideal_rpm * math.tau / 60.0 / settings.servo_per_tendon
    speed = rate if ideal else float(settings.tendon_speed(voltage))
    return Servo(
        gain=1.0 / settings.lag,
        speed=speed,
        speed_loss=0.0
        if ideal
        else 1.0 / float(settings.tendon_stall(voltage)),
        pid=settings.model == "pid",
        proportional=settings.proportional,
        integral=settings.integral,
        derivative=settings.derivative,
        motor_time=settings.motor_time,
        play=math.radians(settings.backlash_deg) / 2,
    )


@helper
def spool_rate(law, drive, command, angle, torque, h):
    """Mean rate of the tendon angle over the next h (s), rad/s, positive when pulling.

    drive (3,), updated in place: motor's angle minus the spool's (rad), motor's speed (rad/s),
    duty of the integral. command, angle: rad; torque: load on the spool without friction, N m.

    The friction of the tendon's guide multiplies the load while the spool winds and divides it
    while it releases. Between the two loads the spool stands still.
    """
    winding, releasing = torque * law.friction, torque / law.friction
    if law.pid:
        free, give = drive_free(law, drive, command, angle, h)
        pulled, let_go = free - give * winding, free - give * releasing
    else:
        pulled = turning_rate(law, command, angle, winding)
        let_go = turning_rate(law, command, angle, releasing)
    still = like(0.0, pulled)
    rate = where(pulled > 0.0, pulled, where(let_go < 0.0, let_go, still))
    if law.pid:
        drive[1] = rate
    if law.play == 0.0:
        return rate
    ahead = drive[0] + h * rate
    free = min(max(ahead, like(-law.play, ahead)), like(law.play, ahead))
    drive[0] = where(torque > 0.0, like(law.play, ahead), free)
    return (ahead - drive[0]) / h


@helper
def turning_rate(law, command, angle, torque):
    """Rate of the motor in the models without a pid, rad/s."""
    rate = law.gain * (command - angle)
    upper = law.speed * (1.0 - law.speed_loss * torque)
    lower = -law.speed * (1.0 + law.speed_loss * torque)
    return min(max(rate, lower), upper)


@helper
def drive_free(law, drive, command, angle, h):
    """Motor driven by the pid: rate after h (s) without load, rad/s, and its loss, rad/(s N m).

    Updates the integral in `drive`.
    """
    error = command - angle
    grown = drive[2] + law.integral * h * error
    duty = law.proportional * error + grown - law.derivative * drive[1]
    bounded = min(max(duty, like(-1.0, duty)), like(1.0, duty))
    drive[2] = where((duty - bounded) * error > 0.0, drive[2], grown)
    share = h / (law.motor_time + h)
    free = drive[1] + (law.speed * bounded - drive[1]) * share
    return free, law.speed * law.speed_loss * share
