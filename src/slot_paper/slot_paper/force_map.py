"""The force map as printed, section V-D: tendon angles on a line over the normal forces.

    theta = (f_z + 6.91) / 0.107,  f_z in N, theta in deg

P fits the line to "a series of single-leg deformations" (V-D) or to "independent single-leg
experiments" (III-C). It holds at one height only: a standing leg carries a quarter of the weight at
any height. The bound of 6 N on f_z is 120.65 deg, beyond the largest angle of 116.28 deg.
"""

from dataclasses import dataclass

import numpy as np

from slot_core.arrays import Array
from slot_core.config import quantity


@dataclass(frozen=True)
class ForceAngleLine:
    """Line f_z = slope theta - offset."""

    offset: float = quantity("force at angle zero, negated", "N", 0, 50)
    slope: float = quantity(
        "slope of the force over the angle", "N/deg", 1e-3, 10
    )

    def angle(self, normal: Array) -> Array:
        """Tendon angles, rad, for normal forces (N); not limited to the servo's range."""
        return np.asarray((normal + self.offset) / np.degrees(self.slope))
