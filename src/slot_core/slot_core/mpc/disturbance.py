"""Disturbance observer: mass error and acceleration bias of the MPC's torso model.

The model predicts the torso's twist w = [omega, v] from one tick to the next with the present
estimates. The innovation, as an acceleration e = (w - w_predicted) / dt, corrects them with the
gain L = 1 - exp(-dt / time). Its z component is taken as a mass error (at rest sum f_z = m g, hence
dm = -m e_z / g), the others as a bias b of the acceleration. The observer assumes that the legs
exert the requested forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slot_core.config import quantity
from slot_core.elementary import exp
from slot_core.key_frame import StateParts
from slot_core.robot import GRAVITY, Array

Z = 5  # index of the linear acceleration along z


@dataclass(frozen=True)
class DisturbanceSettings:
    """Time constant and bounds of the observer."""

    time: float = quantity(
        "time constant of the observer; 0: no observer", "s", 0.0, 100.0
    )
    mass_error: float = quantity("largest relative error of the mass", "", 0.0, 0.9)
    bias_linear: float = quantity(
        "largest bias of the linear acceleration", "m/s^2", 0.0, 10.0
    )
    bias_angular: float = quantity(
        "largest bias of the angular acceleration", "rad/s^2", 0.0, 100.0
    )


class Disturbance:
    """Estimates of the mass (kg) and of the acceleration bias (6,), rad/s^2 and m/s^2 in odom."""

    STATE = StateParts("mass", "bias")

    def __init__(self, mass: float, settings: DisturbanceSettings):
        self._nominal, self._settings = mass, settings
        self._bias_max = np.repeat([settings.bias_angular, settings.bias_linear], 3)
        self.mass = mass
        self.bias = np.zeros(6)

    def correct(self, predicted: Array, measured: Array, dt: float) -> None:
        """Correct the estimates by the twist (6,) predicted over dt (s) and the measured twist."""
        gain = 1.0 - exp(-dt / self._settings.time)
        error = gain * (measured - predicted) / dt
        low = self._nominal * (1.0 - self._settings.mass_error)
        high = self._nominal * (1.0 + self._settings.mass_error)
        self.mass = min(max(self.mass * (1.0 - error[Z] / GRAVITY), low), high)
        error[Z] = 0.0
        self.bias = np.clip(self.bias + error, -self._bias_max, self._bias_max)
