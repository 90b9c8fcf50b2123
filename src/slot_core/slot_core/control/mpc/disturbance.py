"""What pulls at the torso beside the forces: an observer of mass and bias for the MPC's model.

Between two ticks the torso's twist w = [omega, v] is predicted by the model with the present
estimates; the innovation, as an acceleration e = (w - w_predicted) / dt, corrects them with the
gain L = 1 - exp(-dt / time). Along z it is a mass error (at rest sum f_z = m g, hence
dm = -m e_z / g), otherwise a bias b of the acceleration. The observer trusts that the legs exert
the forces they were asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slot_core.config import quantity
from slot_core.robot import GRAVITY, Array

UP = 5  # z of the linear acceleration


@dataclass(frozen=True)
class DisturbanceSettings:
    """How fast the observer follows, and how far."""

    time: float = quantity("time constant, 0: no observer", "s", 0.0, 100.0)
    mass_error: float = quantity("largest relative error of the mass", "", 0.0, 0.9)
    bias_linear: float = quantity("largest bias of the linear acceleration", "m/s^2", 0.0, 10.0)
    bias_angular: float = quantity("largest bias of the angular one", "rad/s^2", 0.0, 100.0)


class Disturbance:
    """Estimates of mass (kg) and bias (6,), rad/s^2 and m/s^2 in odom."""

    def __init__(self, mass: float, settings: DisturbanceSettings):
        self._nominal, self._settings = mass, settings
        self._most = np.repeat([settings.bias_angular, settings.bias_linear], 3)
        self.mass = mass
        self.bias = np.zeros(6)

    def correct(self, predicted: Array, measured: Array, dt: float) -> None:
        """Learn from the twist (6,) that was predicted over dt (s) and the one that came."""
        if self._settings.time == 0.0 or dt <= 0.0:
            return
        gain = 1.0 - math.exp(-dt / self._settings.time)
        error = gain * (measured - predicted) / dt
        least = self._nominal * (1.0 - self._settings.mass_error)
        most = self._nominal * (1.0 + self._settings.mass_error)
        self.mass = min(max(self.mass * (1.0 - error[UP] / GRAVITY), least), most)
        error[UP] = 0.0
        self.bias = np.clip(self.bias + error, -self._most, self._most)
