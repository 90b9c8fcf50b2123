"""Position control on the host: PID whose output is the servos' PWM duty.

    duty = k_p e + I - k_d w,   e = goal - angle,   dI/dt = k_i e

w is the measured speed through a first-order low-pass filter; the derivative acts on it and not on
e, so that a step of the goal causes no kick. The duty is limited to +-duty_limit and its change to
duty_rate. The integral is held while the duty is at one of these limits and e would drive it
further (anti-windup by clamping: Astrom and Hagglund, Advanced PID Control, 2006, section 3.5).
Four legs at once; angles in rad, time in s, duty 1: full voltage.
"""

import numpy as np

from slot_core.arrays import Array
from slot_core.dynamixel.settings import HostPidSettings
from slot_core.robot import LEGS


class HostPid:
    """PID of the four legs, with its state."""

    def __init__(self, settings: HostPidSettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Set integral, filtered speed and duty to 0."""
        self.integral: Array = np.zeros(len(LEGS))
        self.duty: Array = np.zeros(len(LEGS))
        self._speed: Array = np.zeros(len(LEGS))
        self._missing: Array = np.zeros(len(LEGS))

    def step(self, goal: Array, angle: Array, speed: Array, h: float) -> Array:
        """Duty (4,) for the next h s from goal (rad), angle (rad) and speed (rad/s), each (4,).

        NaN in angle or speed: no reading. A leg without a reading keeps its duty for `blind_time`,
        then its duty is 0. Raises ValueError unless h is positive.
        """
        if h <= 0:
            raise ValueError(f"h = {h}: expected a positive time")
        s, valid = self._settings, np.isfinite(angle) & np.isfinite(speed)
        self._missing = np.where(valid, 0.0, self._missing + h)
        error = np.where(valid, goal - angle, 0.0)
        weight = h / (s.filter_time + h)
        self._speed += np.where(valid, weight * (speed - self._speed), 0.0)
        integral = self.integral + s.i * h * error
        unlimited = s.p * error + integral - s.d * self._speed
        low = np.maximum(self.duty - s.duty_rate * h, -s.duty_limit)
        high = np.minimum(self.duty + s.duty_rate * h, s.duty_limit)
        limited = np.clip(unlimited, low, high)
        winding = (unlimited - limited) * error > 0.0
        self.integral = np.where(winding | ~valid, self.integral, integral)
        held = np.where(self._missing <= s.blind_time, self.duty, 0.0)
        self.duty = np.where(valid, limited, held)
        return self.duty.copy()
