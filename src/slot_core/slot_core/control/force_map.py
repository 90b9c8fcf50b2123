"""From ground reaction forces to tendon angles.

Two maps. `paper`: the line theta = (f_z + 6.91) / 0.107 deg of the paper's force-angle fit.
`incremental`: about the gait's nominal angle,
theta = theta_gait + (f_z - f_ref) / (df_z/dtheta at theta_gait and the clamp's present height),
with slopes tabulated from the static leg (`config/leg_map.csv`). Static equilibrium carries m g at
any height, so only the deviation from the gait's own load can carry information.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.config import choice, quantity
from slot_core.control.gait import GaitPreview
from slot_core.leg_table import read_leg_table
from slot_core.robot import Array, Robot


@dataclass(frozen=True)
class ForceMapSettings:
    """What `config/force_map.yaml` holds."""

    map: str = choice("which map", "incremental", "paper")
    line_offset: float = quantity("paper's line: force at angle zero, negated", "N", 0, 50)
    line_slope: float = quantity("paper's line: slope", "N/deg", 1e-3, 10)
    slope_min: float = quantity("least slope the incremental map divides by", "N/rad", 0.1, 100)
    correction_max_deg: float = quantity("largest correction of the gait's angle", "deg", 0, 120)


@dataclass(frozen=True)
class TendonCommand:
    """Four tendon angles and how they came about."""

    map: str
    angle: Array  # (4,) rad, within [0, angle_max]
    force: Array  # (4,) N, f_z asked for
    slope: Array  # (4,) N/rad
    angle_unclamped: Array  # (4,) rad
    saturated: NDArray[np.bool_]  # (4,) the limits changed the angle


class LegSlope:
    """df_z/dtheta of one leg by bilinear interpolation in tendon angle and clamp height."""

    def __init__(self, theta: Array, height: Array, slope: Array):
        """Grid theta (m,) rad, height (n,) m, slope (m, n) N/rad."""
        self._low = np.array([theta[0], height[0]])
        self._high = np.array([theta[-1], height[-1]])
        self._interpolate = RegularGridInterpolator((theta, height), slope)

    def __call__(self, theta: Array, height: Array) -> Array:
        """N/rad; outside of the table the value at its edge."""
        points = np.clip(np.column_stack([theta, height]), self._low, self._high)
        return self._interpolate(points)


class ForceMap:
    """Turns the MPC's forces into tendon angles around the gait."""

    def __init__(self, robot: Robot, settings: ForceMapSettings, slope: LegSlope):
        self._robot, self._settings, self._slope = robot, settings, slope
        self._last: Array | None = None

    def slope(self, preview: GaitPreview, state: Array) -> Array:
        """(4,) N/rad at the first stage of `preview` and `state` (12,): known before the forces."""
        if self._settings.map == "paper":
            return np.full(4, np.degrees(self._settings.line_slope))
        slope = self._slope(preview.tendon_angle[0], self._clamp_heights(state))
        return np.maximum(slope, self._settings.slope_min)

    def step(self, force: Array, preview: GaitPreview, slope: Array) -> TendonCommand:
        """Angles for forces (4, 3) N in odom at the first stage of `preview` and its `slope`."""
        normal = force[:, 2]
        if self._settings.map == "paper":
            angle = (normal + self._settings.line_offset) / slope
        else:
            angle = preview.tendon_angle[0] + self._correction(normal, preview, slope)
        clamped = self._clamp(angle)
        self._last = clamped
        return TendonCommand(self._settings.map, clamped, normal, slope, angle, clamped != angle)

    def hold(self, preview: GaitPreview) -> TendonCommand:
        """The last angles again; before there are any, the nominal ones of `preview`."""
        angle = self._clamp(preview.tendon_angle[0]) if self._last is None else self._last
        nothing = np.zeros(4)
        return TendonCommand("hold", angle, nothing, nothing, angle, nothing.astype(bool))

    def _clamp(self, angle: Array) -> Array:
        return np.clip(angle, 0.0, self._robot.tendon.angle_max)

    def _correction(self, normal: Array, preview: GaitPreview, slope: Array) -> Array:
        most = np.radians(self._settings.correction_max_deg)
        return np.clip((normal - preview.normal_force[0]) / slope, -most, most)

    def _clamp_heights(self, state: Array) -> Array:
        """(4,) heights of the clamps over the floor, m."""
        return state[5] + Rotation.from_euler("xyz", state[0:3]).apply(self._robot.clamps)[:, 2]


def read_force_map() -> ForceMapSettings:
    """The settings of `config/force_map.yaml`; raises ConfigError."""
    return config.read(ForceMapSettings, "force_map")


def read_leg_slope() -> LegSlope:
    """The table of `config/leg_map.csv`; raises ConfigError when it is missing or not a grid."""
    angle, height, table = read_leg_table(("slope_N_per_rad",))
    return LegSlope(angle, height, table[..., 0])
