"""Force map: tendon angles from ground reaction forces.

    springs        theta = theta_gait + (f_z - f_gait - F_h (h - h_ref)) / F_theta
    incremental    theta = theta_gait + (f_z - f_gait) / F_theta
    paper          theta = (f_z + line_offset) / line_slope, the paper's force-angle fit

theta_gait and f_gait are the gait's nominal angle and normal force, F_theta and F_h the statics of
the leg (`leg_springs.py`). `springs` is evaluated at the reference height h_ref and inverts the
model of the MPC on tendon angles, so that the leg at the present height h exerts what is asked for;
a leg out of contact keeps the gait's angle. `incremental` takes F_theta at the present height and
neglects that the leg is a spring. Until the next command the angle goes on at the rate of
theta_gait (`springs`, `incremental`) or stays (`paper`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slot_core import config
from slot_core.config import quantity
from slot_core.gait.gait import GaitPreview
from slot_core.legs.leg_springs import LegSprings, read_leg_springs
from slot_core.robot import Array, Robot


@dataclass(frozen=True)
class ForceMapSettings:
    """Settings of `config/force_map.yaml`."""

    line_offset: float = quantity("paper's line: force at angle zero, negated", "N", 0, 50)
    line_slope: float = quantity("paper's line: slope", "N/deg", 1e-3, 10)
    slope_min: float = quantity("lower bound of F_theta", "N/rad", 0.1, 100)
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
    rate: Array  # (4,) rad/s, at which the angle goes on until the next command


@dataclass(frozen=True)
class Nominal:
    """Operating point of the legs at stage 0 of a preview and a state."""

    angle: Array  # (4,) rad, of the gait
    force: Array  # (4,) N, at the nominal angles and the present heights
    slope: Array  # (4,) N/rad
    contact: NDArray[np.bool_]  # (4,)
    rate: Array  # (4,) rad/s, of the gait's angles


class ForceMap:
    """Computes tendon angles from the MPC's forces and the gait's nominal angles."""

    def __init__(self, robot: Robot, settings: ForceMapSettings, name: str, springs: LegSprings):
        """Take the name of the map, one of those of the module's docstring."""
        self._robot, self._settings, self._name = robot, settings, name
        self._springs = springs
        self._last: Array | None = None

    def nominal(self, preview: GaitPreview, state: Array) -> Nominal:
        """Angles, forces and slopes of the gait at `state` (12,); they need no forces."""
        angle, force = preview.tendon_angle[0], preview.normal_force[0]
        if self._name == "paper":
            slope = np.full(4, np.degrees(self._settings.line_slope))
            return Nominal(angle, force, slope, _ALL, np.zeros(4))
        height = self._robot.clamp_heights(state[5], *state[:2])
        if self._name == "incremental":
            return Nominal(angle, force, self._springs.at(angle, height).slope, _ALL, preview.rate)
        reference = preview.reference[0]
        at = self._robot.clamp_heights(reference[5], *reference[:2])
        springs = self._springs.at(angle, at)
        present = force + springs.stiffness * (height - at) if preview.posture else force
        return Nominal(angle, present, springs.slope, preview.contact[0], preview.rate)

    def step(self, force: Array, nominal: Nominal) -> TendonCommand:
        """Tendon angles for forces (4, 3) N in odom."""
        normal, slope = force[:, 2], nominal.slope
        if self._name == "paper":
            angle = (normal + self._settings.line_offset) / slope
        else:
            correction = np.where(nominal.contact, (normal - nominal.force) / slope, 0.0)
            angle = nominal.angle + self._limited(correction)
        clamped = self._clamp(angle)
        self._last = clamped
        saturated = clamped != angle
        return TendonCommand(self._name, clamped, normal, slope, angle, saturated, nominal.rate)

    def hold(self, preview: GaitPreview) -> TendonCommand:
        """The last angles; before the first `step`, the nominal angles of `preview`."""
        angle = self._clamp(preview.tendon_angle[0]) if self._last is None else self._last
        zeros = np.zeros(4)
        return TendonCommand("hold", angle, zeros, zeros, angle, zeros.astype(bool), zeros)

    def _clamp(self, angle: Array) -> Array:
        return np.clip(angle, 0.0, self._robot.tendon.angle_max)

    def _limited(self, correction: Array) -> Array:
        if self._name != "incremental":
            return correction
        limit = np.radians(self._settings.correction_max_deg)
        return np.clip(correction, -limit, limit)


_ALL = np.ones(4, dtype=bool)


def read_force_map() -> ForceMapSettings:
    """The settings of `config/force_map.yaml`; raises ConfigError."""
    return config.read(ForceMapSettings, "force_map")


def read_springs() -> LegSprings:
    """Legs as springs with the map's `slope_min`, for MPC and gait alike; raises ConfigError."""
    return read_leg_springs(read_force_map().slope_min)


def make_force_map(robot: Robot, settings: ForceMapSettings, name: str) -> ForceMap:
    """The map of that name with the table of `config/leg_map.csv`; raises ConfigError."""
    return ForceMap(robot, settings, name, read_leg_springs(settings.slope_min))
