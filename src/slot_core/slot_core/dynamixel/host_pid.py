"""The position loop on the host: PID over the servo's PWM.

    duty = k_p e + I - k_d w,   e = goal - angle,   dI/dt = k_i e

w is the measured speed through a first-order filter, so that a step of the goal gives no kick. The
duty keeps within +-limit and changes at most at its rate; the integral rests where the duty is at
either bound and e would drive it further (anti-windup by clamping: Astrom and Hagglund, Advanced
PID Control, 2006, section 3.5). Four legs at once; angles in rad, time in s, duty 1: full voltage.
"""

from __future__ import annotations

import numpy as np

from slot_core.dynamixel.settings import HostPidSettings
from slot_core.robot import LEGS, Array


class HostPid:
    """The loop and its state."""

    def __init__(self, settings: HostPidSettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Start from rest with no duty."""
        self.integral: Array = np.zeros(len(LEGS))
        self.duty: Array = np.zeros(len(LEGS))
        self._speed: Array = np.zeros(len(LEGS))
        self._blind: Array = np.zeros(len(LEGS))

    def step(self, goal: Array, angle: Array, speed: Array, h: float) -> Array:
        """Duty (4,) for the next h s; NaN in `angle` says that there is no reading.

        A leg without a reading keeps its duty for `blind_time`, then gets none.
        """
        if h <= 0:
            raise ValueError(f"h = {h}: expected a positive time")
        s, seen = self._settings, np.isfinite(angle) & np.isfinite(speed)
        self._blind = np.where(seen, 0.0, self._blind + h)
        error = np.where(seen, goal - angle, 0.0)
        share = h / (s.filter_time + h)
        self._speed += np.where(seen, share * (speed - self._speed), 0.0)
        grown = self.integral + s.i * h * error
        wanted = s.p * error + grown - s.d * self._speed
        bounded = self._bounded(wanted, h)
        winding = (wanted - bounded) * error > 0.0
        self.integral = np.where(winding | ~seen, self.integral, grown)
        kept = np.where(self._blind <= s.blind_time, self.duty, 0.0)
        self.duty = np.where(seen, bounded, kept)
        return self.duty.copy()

    def _bounded(self, duty: Array, h: float) -> Array:
        limit, change = self._settings.duty_limit, self._settings.duty_rate * h
        low = np.maximum(self.duty - change, -limit)
        return np.clip(duty, low, np.minimum(self.duty + change, limit))
