"""Legs as springs: normal force of a leg at rest over tendon angle and clamp height.

From the table `config/leg_map.csv` (`legs/leg_map.py`), by bilinear interpolation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slot_core.compiled import helper, kernel
from slot_core.leg_table import LegTable, read_leg_table
from slot_core.robot import Array

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
        """Take a table with `COLUMNS`; slope_min (N/rad): lower bound of F_theta, for the fold."""
        self._angle, self._height = table.angle, table.height
        self._table = np.ascontiguousarray(table.table)
        self._slope_min = slope_min
        self.at(np.zeros(1), np.zeros(1))  # compiles the kernel

    def at(self, angle: Array, height: Array) -> Springs:
        """Statics at tendon angles (rad) and clamp heights (m) of equal shape."""
        flat = np.zeros((np.size(angle), len(COLUMNS)))
        a, h = np.ravel(angle).astype(float), np.ravel(height).astype(float)
        interpolate(self._angle, self._height, self._table, a, h, flat)
        flat[:, 1] = np.maximum(flat[:, 1], self._slope_min)
        flat[:, 2] = np.minimum(flat[:, 2], 0.0)
        return Springs(*(column.reshape(np.shape(angle)) for column in flat.T.copy()))

    def angle(self, force: Array, height: Array) -> Array:
        """Tendon angles (n,) rad at which legs at heights (n,) m carry the forces (n,) N.

        The least such angle; beyond the table's largest force, its largest angle.
        """
        grid = np.broadcast_arrays(self._angle, height[:, None])
        rising = np.maximum.accumulate(self.at(*grid).force, axis=1)
        return np.array([np.interp(f, row, self._angle) for f, row in zip(force, rising)])


@kernel
def interpolate(  # type: ignore[no-untyped-def]  # noqa: PLR0917
    angles, heights, table, angle, height, out
):
    """Rows (n, columns) of a table (a, h, columns) at n points, bilinear, constant outside."""
    for k in range(len(angle)):
        i, p = _place(angles, angle[k])
        j, q = _place(heights, height[k])
        for c in range(out.shape[1]):
            low = (1 - q) * table[i, j, c] + q * table[i, j + 1, c]
            high = (1 - q) * table[i + 1, j, c] + q * table[i + 1, j + 1, c]
            out[k, c] = (1 - p) * low + p * high


@helper
def _place(grid, value):  # type: ignore[no-untyped-def]
    """Index of the cell of a rising grid that holds a value, and the share of its upper end."""
    inside = min(max(value, grid[0]), grid[-1])
    index = min(max(np.searchsorted(grid, inside, side="right") - 1, 0), len(grid) - 2)
    return index, (inside - grid[index]) / (grid[index + 1] - grid[index])


def read_leg_springs(slope_min: float) -> LegSprings:
    """The table of `config/leg_map.csv`; raises ConfigError if it is missing or not a grid."""
    return LegSprings(read_leg_table(COLUMNS), slope_min)
