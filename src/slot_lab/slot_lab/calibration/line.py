"""Force-angle line f_z = b theta - a (theta in deg), the paper's theta = (f_z + a) / b.

Weighted linear regression of force on angle over the samples of one height and friction. With the
residual variance s^2, the weighted sum of squares over n - 2, the intervals are those of Student's
distribution with n - 2 degrees of freedom; with two samples they are undetermined.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from slot_core.arrays import Array
from slot_lab.calibration.data import Datum
from slot_lab.calibration.fit import LEVEL


@dataclass(frozen=True)
class ForceLine:
    """Fitted line; the half widths of its 95 % intervals are NaN for two samples."""

    a: float  # N
    b: float  # N/deg
    a_half_width: float  # N
    b_half_width: float  # N/deg
    residuals: Array  # (n,) N, line minus sample


def fit_line(theta_deg: Array, force: Array, sigma: Array) -> ForceLine:
    """Fit the line to samples (n,): angle, deg, force and its sigma, N.

    Raises ValueError unless two angles differ.
    """
    if np.ptp(theta_deg) == 0.0:
        raise ValueError("a line needs samples at two angles")
    (slope, ordinate), covariance = np.polyfit(
        theta_deg, force, 1, w=1 / sigma, cov="unscaled"
    )
    residuals = slope * theta_deg + ordinate - force
    freedom = len(force) - 2
    half = math.nan
    if freedom > 0:
        variance = np.sum((residuals / sigma) ** 2) / freedom
        half = student.ppf((1 + LEVEL) / 2, freedom) * np.sqrt(variance)
    b_half_width, a_half_width = (half * np.sqrt(np.diag(covariance))).tolist()
    return ForceLine(
        float(-ordinate), float(slope), a_half_width, b_half_width, residuals
    )


def line_groups(rows: Sequence[Datum]) -> dict[tuple[float, float], list[int]]:
    """Indices of the force_angle samples by (height, friction), where two angles differ."""
    groups: dict[tuple[float, float], list[int]] = {}
    for i, row in enumerate(rows):
        if row.kind == "force_angle":
            groups.setdefault((row.height_m, row.friction), []).append(i)
    angles = {
        key: {rows[i].theta_deg for i in members} for key, members in groups.items()
    }
    return {key: members for key, members in groups.items() if len(angles[key]) > 1}
