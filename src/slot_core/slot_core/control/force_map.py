"""Force map: tendon angles from ground reaction forces.

Two maps:

    paper          theta = (f_z + line_offset) / line_slope, the paper's force-angle fit
    incremental    theta = theta_gait + (f_z - f_ref) / (df_z/dtheta)

theta_gait and f_ref are the gait's nominal angle and normal force. The slope df_z/dtheta is that of
the static leg at theta_gait and the present clamp height, from the table `config/leg_map.csv`. In
static equilibrium the legs carry m g at any height, so only the deviation from f_ref is useful.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from slot_core import config
from slot_core.config import choice, quantity
from slot_core.control.gait import GaitPreview
from slot_core.leg_table import read_leg_table
from slot_core.robot import Array, Robot


@dataclass(frozen=True)
class ForceMapSettings:
    """Settings of `config/force_map.yaml`."""

    map: str = choice("map from force to angle", "incremental", "paper")
    line_offset: float = quantity("paper's line: force at angle zero, negated", "N", 0, 50)
    line_slope: float = quantity("paper's line: slope", "N/deg", 1e-3, 10)
    slope_min: float = quantity("incremental: lower bound of the slope", "N/rad", 0.1, 100)
    correction_max_deg: float = quantity("incremental: largest correction", "deg", 0, 120)


@dataclass(frozen=True)
class TendonCommand:
    """Tendon angles of the four legs, with the forces and slopes behind them."""

    map: str
    angle: Array  # (4,) rad, within [0, angle_max]
    force: Array  # (4,) N, requested f_z
    slope: Array  # (4,) N/rad
    angle_unclamped: Array  # (4,) rad, before the limits
    saturated: NDArray[np.bool_]  # (4,) whether the limits changed the angle


class LegSlope:
    """Slope df_z/dtheta of one leg: bilinear interpolation in tendon angle and clamp height."""

    def __init__(self, theta: Array, height: Array, slope: Array):
        """Grid theta (m,) rad, height (n,) m, slope (m, n) N/rad."""
        self._low = np.array([theta[0], height[0]])
        self._high = np.array([theta[-1], height[-1]])
        self._interpolate = RegularGridInterpolator((theta, height), slope)

    def __call__(self, theta: Array, height: Array) -> Array:
        """Slope (n,) N/rad at theta (n,) rad and height (n,) m; outside, that at the edge."""
        points = np.clip(np.column_stack([theta, height]), self._low, self._high)
        return self._interpolate(points)


class ForceMap:
    """Computes tendon angles from the MPC's forces and the gait's nominal angles."""

    def __init__(self, robot: Robot, settings: ForceMapSettings, slope: LegSlope):
        self._robot, self._settings, self._slope = robot, settings, slope
        self._last: Array | None = None

    def slope(self, preview: GaitPreview, state: Array) -> Array:
        """Slopes (4,) N/rad at stage 0 of `preview` and at `state` (12,); they need no forces."""
        if self._settings.map == "paper":
            return np.full(4, np.degrees(self._settings.line_slope))
        height = self._robot.clamp_heights(state[0:3], state[5])
        slope = self._slope(preview.tendon_angle[0], height)
        return np.maximum(slope, self._settings.slope_min)

    def step(self, force: Array, preview: GaitPreview, slope: Array) -> TendonCommand:
        """Tendon angles for forces (4, 3) N in odom at stage 0 of `preview`.

        slope: (4,) N/rad, from `slope()`.
        """
        normal = force[:, 2]
        if self._settings.map == "paper":
            angle = (normal + self._settings.line_offset) / slope
        else:
            angle = preview.tendon_angle[0] + self._correction(normal, preview, slope)
        clamped = self._clamp(angle)
        self._last = clamped
        return TendonCommand(self._settings.map, clamped, normal, slope, angle, clamped != angle)

    def hold(self, preview: GaitPreview) -> TendonCommand:
        """The last angles; before the first `step`, the nominal angles of `preview`."""
        angle = self._clamp(preview.tendon_angle[0]) if self._last is None else self._last
        zeros = np.zeros(4)
        return TendonCommand("hold", angle, zeros, zeros, angle, zeros.astype(bool))

    def _clamp(self, angle: Array) -> Array:
        return np.clip(angle, 0.0, self._robot.tendon.angle_max)

    def _correction(self, normal: Array, preview: GaitPreview, slope: Array) -> Array:
        limit = np.radians(self._settings.correction_max_deg)
        return np.clip((normal - preview.normal_force[0]) / slope, -limit, limit)


def read_force_map() -> ForceMapSettings:
    """The settings of `config/force_map.yaml`; raises ConfigError."""
    return config.read(ForceMapSettings, "force_map")


def read_leg_slope() -> LegSlope:
    """The slope table of `config/leg_map.csv`; raises ConfigError if it is missing or no grid."""
    angle, height, table = read_leg_table(("slope_N_per_rad",))
    return LegSlope(angle, height, table[..., 0])
