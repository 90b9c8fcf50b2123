"""Gait scheduler: nominal tendon angles, contact schedule and normal forces over the horizon.

A gait is periodic. With the phase p = 2 pi t / T, each leg's tendon angle is

    theta = m + c1 cos p + s1 sin p + c2 cos 2p + s2 sin 2p,

clipped to the gait's range; an amplitude below one scales it about its mean over the stride. The
normal forces and the torso sway that result on the simulated robot are tabulated in the same form
(`scripts/tabulate_gait`), so that the controller corrects deviations from the gait, not the gait.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slot_core import config
from slot_core.config import quantity
from slot_core.control.reference import reference
from slot_core.robot import Array

STAND = "stand"  # name of the gait without motion
Harmonics = tuple[float, float, float, float, float]
FourHarmonics = tuple[Harmonics, Harmonics, Harmonics, Harmonics]


class HarmonicBasis(NamedTuple):
    """The four harmonics at n phases, and their derivatives by the phase."""

    value: Array  # (n, 4) cos p, sin p, cos 2p, sin 2p with p = 2 pi phase
    slope: Array  # (n, 4)

    @classmethod
    def at(cls, phase: Array) -> HarmonicBasis:
        """Harmonics at phases (n,), in [0, 1)."""
        p = 2 * np.pi * phase
        value = np.column_stack([np.cos(p), np.sin(p), np.cos(2 * p), np.sin(2 * p)])
        slope = [-value[:, 1], value[:, 0], -2 * value[:, 3], 2 * value[:, 2]]
        return cls(value, np.column_stack(slope) * (2 * np.pi))


class FourierSeries:
    """Fourier series m + amplitude (c1 cos p + s1 sin p + c2 cos 2p + s2 sin 2p), one per row."""

    def __init__(self, table: Sequence[Harmonics]):
        mean, weights = np.split(np.array(table), [1], axis=1)
        self._mean, self._weights = mean.T, weights.T

    def values(self, basis: HarmonicBasis, amplitude: float) -> Array:
        """Values (n, rows of the table)."""
        return self._mean + amplitude * basis.value @ self._weights

    def rates(self, basis: HarmonicBasis, amplitude: float) -> Array:
        """Derivatives by the phase (n, rows of the table)."""
        return amplitude * basis.slope @ self._weights


@dataclass(frozen=True)
class Sway:
    """Periodic motion of the torso; coefficients in the order m, c1, s1, c2, s2."""

    roll: Harmonics = quantity("roll", "rad", -1, 1)
    pitch: Harmonics = quantity("pitch", "rad", -1, 1)
    height: Harmonics = quantity("height of base_link", "m", -0.2, 0.2)
    v_x: Harmonics = quantity("forward velocity about its mean", "m/s", -1, 1)
    v_y: Harmonics = quantity("lateral velocity about its mean", "m/s", -1, 1)

    def rows(self, basis: HarmonicBasis, amplitude: float, period: float) -> Array:
        """Torso states (n, 12) [roll pitch 0, 0 0 z, omega, v_x v_y v_z] in the heading frame.

        period: s. omega is [roll rate, pitch rate, 0], correct to first order in the angles.
        """
        rows = np.zeros((len(basis.value), 12))
        rows[:, [0, 1, 5, 9, 10]] = self._series.values(basis, amplitude)
        rows[:, [6, 7, 11]] = self._series.rates(basis, amplitude)[:, :3] / period
        return rows

    @cached_property
    def _series(self) -> FourierSeries:
        return FourierSeries((self.roll, self.pitch, self.height, self.v_x, self.v_y))


@dataclass(frozen=True)
class Gait:
    """Periodic gait; coefficients in the order m, c1, s1, c2, s2, legs FL FR RL RR."""

    sway: Sway
    period: float = quantity("duration of a stride", "s", 0.1, 10.0)
    cruise: float = quantity("v_x if none is requested", "m/s", -1, 1)
    speed: tuple[float, ...] = quantity("tabulated v_x, rising", "m/s", -1, 1)
    amplitude: tuple[float, ...] = quantity("scale of the harmonics at these speeds", "", 0, 1)
    angle_deg: FourHarmonics = quantity("tendon angle", "deg", -360, 360)
    range_deg: tuple[float, float] = quantity("clip of the tendon angle", "deg", 0, 360)
    normal_force: FourHarmonics = quantity("normal force of the ground", "N", -50, 50)

    def __post_init__(self) -> None:
        """Raise ConfigError unless speed rises and has one value for each amplitude."""
        if len(self.speed) != len(self.amplitude) or list(self.speed) != sorted(set(self.speed)):
            raise config.ConfigError(
                f"speed = {self.speed}: expected one rising value for each amplitude"
            )

    def amplitude_at(self, speed: float) -> float:
        """Scale of the harmonics for a forward speed (m/s), interpolated linearly."""
        return float(np.interp(speed, self.speed, self.amplitude))

    def course(self, phase: Array, amplitude: float) -> Array:
        """Gait (n, 20) at phases (n,): 4 tendon angles (rad), 4 normal forces (N), 12 torso states.

        The torso states are those of `Sway.rows`.
        """
        basis = HarmonicBasis.at(phase)
        angle = self._mean_angle + amplitude * (self._full_angle(basis) - self._mean_angle)
        force = self._normal_force.values(basis, amplitude)
        sway = self.sway.rows(basis, amplitude, self.period)
        return np.hstack([angle, np.maximum(force, 0.0), sway])

    def _full_angle(self, basis: HarmonicBasis) -> Array:
        """Tendon angles (n, 4) at full amplitude, rad."""
        return np.radians(np.clip(self._angle.values(basis, 1.0), *self.range_deg))

    @cached_property
    def _angle(self) -> FourierSeries:
        return FourierSeries(self.angle_deg)

    @cached_property
    def _normal_force(self) -> FourierSeries:
        return FourierSeries(self.normal_force)

    @cached_property
    def _mean_angle(self) -> Array:
        """Mean (4,) over the stride, rad; clipping makes it differ from m."""
        stride = HarmonicBasis.at(np.linspace(0.0, 1.0, 1000, endpoint=False))
        return self._full_angle(stride).mean(axis=0)


@dataclass(frozen=True)
class GaitSettings:
    """Settings of `config/gait.yaml`."""

    gaits: dict[str, Gait]
    friction: float = quantity("friction coefficient assumed by the controller", "", 0, 2)
    contact_force: float = quantity("smallest normal force of a leg in stance", "N", 0, 10)
    transition: float = quantity("duration of a blend between gaits", "s", 0, 10)
    velocity_timeout: float = quantity("age at which a velocity command expires", "s", 0.05, 10)
    stages: int = quantity("stages of the preview, at least the MPC's horizon", "", 1, 100)
    dt: float = quantity("time between stages", "s", 1e-3, 0.2)

    def find(self, name: str) -> Gait:
        """The gait of that name; raises ConfigError for an unknown one and lists the known ones."""
        if name not in self.gaits:
            raise config.ConfigError(f"no gait {name!r} (known: {', '.join(sorted(self.gaits))})")
        return self.gaits[name]


@dataclass(frozen=True)
class GaitPreview:
    """Preview of contact, friction, angles and reference at the stages 0 .. n-1 of the horizon.

    Stage k is at `stamp + k dt`. Legs in the order FL FR RL RR, frame odom.
    """

    stamp: int  # ns
    gait: str
    phase: float  # of stage 0, in [0, 1)
    period: float  # s
    dt: float  # s
    contact: NDArray[np.bool_]  # (n, 4) whether the leg may carry load
    friction: Array  # (n, 4) coefficient assumed by the controller
    normal_force: Array  # (n, 4) N, of the gait
    tendon_angle: Array  # (n, 4) rad, nominal
    reference: Array  # (n, 12) [roll pitch yaw, p, omega, v]
    posture: bool = False  # whether the gait is a posture: its legs are at rest


@dataclass(frozen=True)
class _Stride:
    """A gait at an amplitude; its phase is zero at `origin` (ns)."""

    name: str
    gait: Gait
    amplitude: float
    origin: int

    def phase(self, stamp: int, times: Array) -> Array:
        """Phases (n,) at `times` (s) after `stamp` (ns)."""
        return np.mod(((stamp - self.origin) * 1e-9 + times) / self.gait.period, 1.0)

    def course(self, stamp: int, times: Array) -> Array:
        """`Gait.course` (n, 20) at `times` (s) after `stamp` (ns)."""
        return self.gait.course(self.phase(stamp, times), self.amplitude)


class GaitScheduler:
    """Advances the phase of the gait and previews the horizon at every tick of the controller.

    A change of gait or speed is a linear blend over `transition` seconds; a request during a blend
    takes effect at its end. A run starts from the gait `stand`.
    """

    def __init__(self, settings: GaitSettings, gait: str, velocity: Array | None):
        """Blend from `stand` to `gait` at velocity [v_x, v_y, yaw rate] from the first tick on.

        velocity: (3,) m/s, m/s, rad/s in base_link; None: straight ahead at the gait's `cruise`.
        Raises ConfigError for an unknown gait or a velocity outside the gait's range.
        """
        self._settings = settings
        if velocity is None:
            velocity = np.array([settings.find(gait).cruise, 0.0, 0.0])
        self.request(gait, velocity)
        self._previous = self._current = _Stride(STAND, settings.find(STAND), 0.0, 0)
        self._blend_start = 0  # ns, stamp of the last change of stride
        self._stamp: int | None = None
        self._heading = 0.0

    def request(self, gait: str, velocity: Array) -> None:
        """Request a gait and a velocity [v_x, v_y, yaw rate] (m/s, rad/s) in base_link.

        Raises ConfigError for an unknown gait or a velocity outside the gait's range.
        """
        speed = self._settings.find(gait).speed
        low, high = speed[0], speed[-1]
        if len(velocity) != 3:
            raise config.ConfigError(f"velocity: {len(velocity)} values, not v_x, v_y, yaw rate")
        limits = (("v_x", low, high), ("v_y", 0.0, 0.0), ("yaw rate", 0.0, 0.0))
        for value, (name, least, most) in zip(velocity, limits):
            if not least <= value <= most:
                raise config.ConfigError(
                    f"{name} = {value:g}: gait {gait} reaches [{least:g}, {most:g}]"
                )
        self._requested, self._velocity = gait, np.array(velocity, dtype=float)
        self._command_stamp: int | None = None  # ns, of the velocity; None: it does not expire

    def set_velocity(self, stamp: int, velocity: Array) -> None:
        """Set the velocity of the requested gait; after `velocity_timeout` it becomes zero.

        stamp: ns, on the clock of the states. Raises ConfigError as `request` does, and for a stamp
        further than `velocity_timeout` from the last state's. Such a command stops the robot, since
        it may have been a late stop.
        """
        self.request(self._requested, velocity)
        self._command_stamp = stamp
        if self._stamp is not None and self._is_expired(self._stamp):
            raise config.ConfigError(
                f"stamp is {(stamp - self._stamp) * 1e-9:+.3f} s from the state's (limit "
                f"{self._settings.velocity_timeout:g} s), velocity set to zero"
            )

    def step(self, stamp: int, state: Array) -> GaitPreview:
        """Preview from `stamp` (ns) on; the reference starts at `state` (12,)."""
        if self._is_expired(stamp):
            self._velocity = np.zeros(3)
        self._advance_heading(stamp, state)
        self._change_stride(stamp)
        times = self._settings.dt * np.arange(self._settings.stages, dtype=float)
        angle, force, sway = np.split(self._blend(stamp, times), [4, 8], axis=1)
        current = self._current
        return GaitPreview(
            stamp=stamp,
            gait=current.name,
            phase=float(current.phase(stamp, times)[0]),
            period=current.gait.period,
            dt=self._settings.dt,
            contact=force >= self._settings.contact_force,
            friction=np.full(force.shape, self._settings.friction),
            normal_force=force,
            tendon_angle=angle,
            reference=reference(state, self._heading, self._velocity, sway, times),
        )

    def _is_expired(self, stamp: int) -> bool:
        """Whether the velocity is too old at `stamp` (ns), or too far in the future."""
        if self._command_stamp is None:
            return False
        return abs(stamp - self._command_stamp) > self._settings.velocity_timeout * 1e9

    def _advance_heading(self, stamp: int, state: Array) -> None:
        """Update the reference heading: the robot's yaw, then the integral of the yaw rate."""
        if self._stamp is None:
            self._heading, self._blend_start = float(state[2]), stamp - self._transition
        else:
            self._heading += self._velocity[2] * (stamp - self._stamp) * 1e-9
        self._stamp = stamp
        # A clock set back must not delay the next change.
        self._blend_start = min(self._blend_start, stamp)

    def _change_stride(self, stamp: int) -> None:
        """Start the requested gait and amplitude, unless a blend is under way."""
        gait = self._settings.find(self._requested)
        amplitude = gait.amplitude_at(self._velocity[0])
        current = self._current
        unchanged = (self._requested, amplitude) == (current.name, current.amplitude)
        if unchanged or stamp - self._blend_start < self._transition:
            return
        origin = current.origin if self._requested == current.name else stamp
        self._previous, self._blend_start = current, stamp
        self._current = _Stride(self._requested, gait, amplitude, origin)

    def _blend(self, stamp: int, times: Array) -> Array:
        """Blend (n, 20) of the previous and the current stride, as `Gait.course`."""
        elapsed = (stamp - self._blend_start) * 1e-9 + times
        weight = np.clip(elapsed / max(self._settings.transition, 1e-9), 0.0, 1.0)[:, None]
        current = self._current.course(stamp, times)
        if weight.min() == 1.0:
            return current
        return (1 - weight) * self._previous.course(stamp, times) + weight * current

    @property
    def _transition(self) -> int:
        """Duration of a blend, ns."""
        return round(self._settings.transition * 1e9)


def read_gaits() -> GaitSettings:
    """The settings of `config/gait.yaml`; raises ConfigError."""
    return config.read(GaitSettings, "gait")
