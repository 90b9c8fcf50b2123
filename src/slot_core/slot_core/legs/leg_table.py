"""Tabulated statics of a leg, `config/leg_map.csv`: reader and bilinear interpolation.

`scripts/calibrate --leg-map` writes the file; `slot_lab.leg_tests.leg_map` defines its columns.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slot_core import config
from slot_core.arrays import Array, checked
from slot_core.compiled import helper, kernel
from slot_core.refusal import read_text

SIZE_MAX = 10_000_000  # bytes of the file


@dataclass(frozen=True)
class LegTable:
    """Columns of the leg map on its grid of tendon angle and clamp height.

    Raises ValueError unless angles and heights are two or more, and rise, and the table is finite.
    """

    angle: Array  # (m,) rad, rising
    height: Array  # (n,) m, rising
    table: Array  # (m, n, requested columns)

    def __post_init__(self) -> None:
        grid = [
            checked("grid", values, (-1,))
            for values in (self.angle, self.height)
        ]
        checked("table", self.table, (*map(len, grid), -1))
        for values in grid:
            if len(values) < 2 or not (np.diff(values) > 0.0).all():
                raise ValueError(
                    "grid: expected two or more angles and heights that rise"
                )

    def at(self, angle: Array, height: Array) -> Array:
        """Columns (k, c) at angles (k,) rad and heights (k,) m, bilinear; outside: at the edge.

        NaN gives NaN. Raises ValueError for other shapes.
        """
        a = checked("angles", angle, (-1,), finite=False)
        h = checked("heights", height, a.shape, finite=False)
        columns = np.zeros((len(a), self.table.shape[2]))
        interpolate(self.angle, self.height, self.table, a, h, columns)
        return columns


def read_leg_table(columns: Sequence[str]) -> LegTable:
    """Columns of `config/leg_map.csv`; raises ConfigError if it is missing or not a grid."""
    names = ("theta_deg", "height_m", *columns)
    try:
        lines = read_text(
            config.config_dir() / "leg_map.csv", SIZE_MAX
        ).splitlines()
        rows = [
            [float(row[name]) for name in names]
            for row in csv.DictReader(lines)
        ]
        theta_deg, height, *values = np.array(sorted(rows)).T
        angles, heights = np.unique(theta_deg), np.unique(height)
        table = np.array(values).T.reshape(
            len(angles), len(heights), len(columns)
        )
        return LegTable(
            np.radians(angles), heights, np.ascontiguousarray(table)
        )
    except (OSError, KeyError, TypeError, ValueError, csv.Error) as error:
        raise config.ConfigError(
            f"leg_map.csv: no table of {names}: {error}"
        ) from None


@kernel
def interpolate(  # type: ignore[no-untyped-def]  # noqa: PLR0917
    angles, heights, table, angle, height, out
):
    """Rows (k, c) of a table (m, n, c) at k points, bilinear; outside: at the edge.

    angles (m,), heights (n,): the grid, rising; angle, height (k,): the points; out (k, c).
    """
    for k in range(len(angle)):
        i, p = _place(angles, angle[k])
        j, q = _place(heights, height[k])
        for c in range(out.shape[1]):
            low = (1 - q) * table[i, j, c] + q * table[i, j + 1, c]
            high = (1 - q) * table[i + 1, j, c] + q * table[i + 1, j + 1, c]
            out[k, c] = (1 - p) * low + p * high


@helper
def _place(grid, value):  # type: ignore[no-untyped-def]
    """Index of the cell of a rising grid that holds a value, and the share of its upper end.

    Below the grid the share is 0, above it 1.
    """
    inside = min(max(value, grid[0]), grid[-1])
    index = min(
        max(np.searchsorted(grid, inside, side="right") - 1, 0), len(grid) - 2
    )
    return index, (inside - grid[index]) / (grid[index + 1] - grid[index])
