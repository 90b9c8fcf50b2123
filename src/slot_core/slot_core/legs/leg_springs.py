"""Legs as springs: normal force of a leg at rest over tendon angle and clamp height.

From the table `config/leg_map.csv` (`slot_lab.leg_tests.leg_map`), by bilinear interpolation.
"""

from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array, checked
from slot_core.legs.leg_table import LegTable, read_leg_table
from slot_core.matrices import interpolated

COLUMNS = ("force_N", "slope_N_per_rad", "stiffness_N_per_m", "contact_x_m")


class Springs(NamedTuple):
    """Statics of legs; every array has the shape of the angles they were evaluated at."""

    force: Array  # F, N
    slope: Array  # F_theta, N/rad
    stiffness: Array  # F_h, N/m, negative where the leg is stable
    contact: Array  # m, contact from the clamp, along the leg's azimuth


class LegSprings:
    """Table of F, F_theta, F_h and the place of contact; outside of it the values at its edge."""

    def __init__(self, table: LegTable, slope_min: float):
        """Take a table with `COLUMNS`; slope_min (N/rad): lower bound of F_theta, for the fold.

        Raises ValueError for a table with other columns.
        """
        checked("table", table.table, (-1, -1, len(COLUMNS)))
        self._table, self._slope_min = table, slope_min
        self.at(np.zeros(1), np.zeros(1))  # compiles the kernel

    def at(self, angle: Array, height: Array) -> Springs:
        """Statics at tendon angles (rad) and clamp heights (m) of one shape; raises ValueError."""
        if np.shape(angle) != np.shape(height):
            raise ValueError(
                f"angles {np.shape(angle)}, heights {np.shape(height)}: not equal"
            )
        flat = self._table.at(np.ravel(angle), np.ravel(height))
        flat[:, 1] = np.maximum(flat[:, 1], self._slope_min)
        flat[:, 2] = np.minimum(flat[:, 2], 0.0)
        return Springs(
            *(column.reshape(np.shape(angle)) for column in flat.T.copy())
        )

    def angle(self, force: Array, height: Array) -> Array:
        """Tendon angles (n,) rad at which legs at heights (n,) m carry the forces (n,) N.

        The least such angle; beyond the table's largest force, its largest angle. Raises ValueError
        for other shapes.
        """
        angles, force = self._table.angle, checked("forces", force, (-1,))
        height = checked("heights", height, force.shape)
        grid = np.broadcast_arrays(angles, height[:, None])
        rising = np.maximum.accumulate(self.at(*grid).force, axis=1)
        return np.array(
            [interpolated(f, row, angles) for f, row in zip(force, rising)]
        )


def read_leg_springs(slope_min: float) -> LegSprings:
    """The table of `config/leg_map.csv`; raises ConfigError if it is missing or not a grid."""
    return LegSprings(read_leg_table(COLUMNS), slope_min)
