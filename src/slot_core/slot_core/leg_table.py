"""Reader of the tabulated statics of a leg, `config/leg_map.csv`.

The file is written by `scripts/tabulate_leg`; its columns are defined in `legs/leg_map.py`.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slot_core import config
from slot_core.robot import Array


class LegTable(NamedTuple):
    """Columns of the leg map on its grid of tendon angle and height."""

    angle: Array  # (m,) rad
    height: Array  # (n,) m
    table: Array  # (m, n, requested columns)


def read_leg_table(columns: Sequence[str]) -> LegTable:
    """Columns of `config/leg_map.csv`; raises ConfigError if it is missing or not a grid."""
    names = ("theta_deg", "height_m", *columns)
    try:
        with (config.config_dir() / "leg_map.csv").open() as file:
            rows = [[float(row[name]) for name in names] for row in csv.DictReader(file)]
        theta_deg, height, *values = np.array(sorted(rows)).T
        angles, heights = np.unique(theta_deg), np.unique(height)
        table = np.array(values).T.reshape(len(angles), len(heights), len(columns))
        return LegTable(np.radians(angles), heights, table)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise config.ConfigError(f"leg_map.csv: no table of {names}: {error}") from None
