"""Gaits: nominal tendon angles, contact schedule and load of the legs over the horizon.

A gait is periodic. With the phase p = 2 pi t / T, each leg's tendon angle is
theta = m + c1 cos p + s1 sin p + c2 cos 2p + s2 sin 2p, clipped to the gait's range; a smaller
amplitude shrinks it towards its mean over the stride. What the plant
answers with, the normal force on each leg and the sway of the torso, is tabulated in the same form
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

STAND = "stand"  # the gait that stays where it is
Harmonics = tuple[float, float, float, float, float]
FourHarmonics = tuple[Harmonics, Harmonics, Harmonics, Harmonics]


class Waves(NamedTuple):
    """The four harmonics at n phases, and their derivatives with respect to the phase."""

    value: Array  # (n, 4) cos p, sin p, cos 2p, sin 2p with p = 2 pi phase
    slope: Array  # (n, 4)

    @classmethod
    def at(cls, phase: Array) -> Waves:
        """The waves at phases (n,)."""
        turn = 2 * np.pi
        p = turn * phase
        value = np.column_stack([np.cos(p), np.sin(p), np.cos(2 * p), np.sin(2 * p)])
        slope = [-value[:, 1], value[:, 0], -2 * value[:, 3], 2 * value[:, 2]]
        return cls(value, np.column_stack(slope) * turn)


class FourierSeries:
    """Sums of harmonics: m + amplitude (c1 cos p + s1 sin p + c2 cos 2p + s2 sin 2p)."""

    def __init__(self, table: Sequence[Harmonics]):
        mean, weights = np.split(np.array(table), [1], axis=1)
        self._mean, self._weights = mean.T, weights.T

    def values(self, waves: Waves, amplitude: float) -> Array:
        """(n, rows of the table)."""
        return self._mean + amplitude * waves.value @ self._weights

    def rates(self, waves: Waves, amplitude: float) -> Array:
        """(n, rows of the table), their derivatives with respect to the phase."""
        return amplitude * waves.slope @ self._weights


@dataclass(frozen=True)
class Sway:
    """Periodic motion of the torso; coefficients in the order m, c1, s1, c2, s2."""

    roll: Harmonics = quantity("roll", "rad", -1, 1)
    pitch: Harmonics = quantity("pitch", "rad", -1, 1)
    height: Harmonics = quantity("height of base_link", "m", -0.2, 0.2)
    v_x: Harmonics = quantity("forward velocity about its mean", "m/s", -1, 1)
    v_y: Harmonics = quantity("lateral velocity about its mean", "m/s", -1, 1)

    def rows(self, waves: Waves, amplitude: float, period: float) -> Array:
        """(n, 12) [roll pitch 0, 0 0 z, rates, v_x v_y v_z] in the heading frame.

        Angular velocity is taken as the rate of roll and pitch, right to first order in them.
        """
        rows = np.zeros((len(waves.value), 12))
        rows[:, [0, 1, 5, 9, 10]] = self._series.values(waves, amplitude)
        rows[:, [6, 7, 11]] = self._series.rates(waves, amplitude)[:, :3] / period
        return rows

    @cached_property
    def _series(self) -> FourierSeries:
        return FourierSeries((self.roll, self.pitch, self.height, self.v_x, self.v_y))


@dataclass(frozen=True)
class Gait:
    """One periodic gait; coefficients in the order m, c1, s1, c2, s2, legs FL FR RL RR."""

    sway: Sway
    period: float = quantity("duration of a stride", "s", 0.1, 10.0)
    cruise: float = quantity("v_x where none is asked for", "m/s", -1, 1)
    speed: tuple[float, ...] = quantity("v_x reached, least to greatest", "m/s", -1, 1)
    amplitude: tuple[float, ...] = quantity("scale of the harmonics at these speeds", "", 0, 1)
    angle_deg: FourHarmonics = quantity("tendon angle", "deg", -360, 360)
    range_deg: tuple[float, float] = quantity("clip of the tendon angle", "deg", 0, 116.28)
    normal_force: FourHarmonics = quantity("normal force of the ground", "N", -50, 50)

    def __post_init__(self) -> None:
        """Raise ConfigError unless speed and amplitude make a table."""
        if len(self.speed) != len(self.amplitude) or list(self.speed) != sorted(set(self.speed)):
            raise config.ConfigError(
                f"speed = {self.speed}: expected one rising value for each amplitude"
            )

    def amplitude_at(self, speed: float) -> float:
        """Scale of the harmonics for a forward speed (m/s), linear between the tabulated ones."""
        return float(np.interp(speed, self.speed, self.amplitude))

    def course(self, phase: Array, amplitude: float) -> Array:
        """(n, 20): four tendon angles (rad), four normal forces (N), sway (12), at phases (n,)."""
        waves = Waves.at(phase)
        angle = self._mean_angle + amplitude * (self._full_angle(waves) - self._mean_angle)
        load = self._load.values(waves, amplitude)
        sway = self.sway.rows(waves, amplitude, self.period)
        return np.hstack([angle, np.maximum(load, 0.0), sway])

    def _full_angle(self, waves: Waves) -> Array:
        """(n, 4) tendon angles at full amplitude, rad."""
        return np.radians(np.clip(self._angle.values(waves, 1.0), *self.range_deg))

    @cached_property
    def _angle(self) -> FourierSeries:
        return FourierSeries(self.angle_deg)

    @cached_property
    def _load(self) -> FourierSeries:
        return FourierSeries(self.normal_force)

    @cached_property
    def _mean_angle(self) -> Array:
        """(4,) mean over the stride, about which the amplitude scales: clipping moves it off m."""
        stride = Waves.at(np.linspace(0.0, 1.0, 1000, endpoint=False))
        return self._full_angle(stride).mean(axis=0)


@dataclass(frozen=True)
class GaitSettings:
    """What `config/gait.yaml` holds."""

    gaits: dict[str, Gait]
    friction: float = quantity("coefficient the controller counts on", "", 0, 2)
    contact_force: float = quantity("least load of a leg that counts as stance", "N", 0, 10)
    transition: float = quantity("time from one gait to the next", "s", 0, 10)
    command_timeout: float = quantity("age at which a velocity command expires", "s", 0.05, 10)
    stages: int = quantity("stages of the preview, at least the MPC's horizon", "", 1, 100)
    dt: float = quantity("time between stages", "s", 1e-3, 0.2)

    def find(self, name: str) -> Gait:
        """The gait of that name; raises ConfigError naming the known ones."""
        if name not in self.gaits:
            raise config.ConfigError(f"no gait {name!r} (known: {', '.join(sorted(self.gaits))})")
        return self.gaits[name]


@dataclass(frozen=True)
class GaitPreview:
    """Contact schedule, friction and reference at the stages 0 .. n-1 of the horizon.

    Stage k is at `stamp + k dt`. Legs in the order FL FR RL RR, frame odom.
    """

    stamp: int  # ns
    gait: str
    phase: float  # of stage 0, in [0, 1)
    period: float  # s
    dt: float  # s
    contact: NDArray[np.bool_]  # (n, 4) the leg may carry load
    friction: Array  # (n, 4) coefficient the controller may count on
    normal_force: Array  # (n, 4) N, expected by the gait
    tendon_angle: Array  # (n, 4) rad, nominal
    reference: Array  # (n, 12) [roll pitch yaw, p, omega, v]


@dataclass(frozen=True)
class _Stride:
    """A gait at an amplitude, its phase zero at `origin` (ns)."""

    name: str
    gait: Gait
    amplitude: float
    origin: int

    def phase(self, stamp: int, times: Array) -> Array:
        """(n,) phase at `times` (s) after `stamp` (ns)."""
        return np.mod(((stamp - self.origin) * 1e-9 + times) / self.gait.period, 1.0)

    def course(self, stamp: int, times: Array) -> Array:
        """(n, 20) as `Gait.course`, at `times` (s) after `stamp` (ns)."""
        return self.gait.course(self.phase(stamp, times), self.amplitude)


class GaitScheduler:
    """Keeps the phase of the gait and previews the horizon at every tick of the controller.

    Gaits follow each other by a linear blend over `transition` seconds; a request made meanwhile
    waits until it is over. A run starts from the gait `stand`.
    """

    def __init__(self, settings: GaitSettings, gait: str, velocity: Array | None):
        """Go from `stand` to `gait` at velocity [v_x, v_y, yaw rate] from the first tick on.

        None stands for the gait's own velocity, straight ahead at its `cruise`.
        Raises ConfigError for an unknown gait or a velocity it cannot reach.
        """
        self._settings = settings
        if velocity is None:
            velocity = np.array([settings.find(gait).cruise, 0.0, 0.0])
        self.request(gait, velocity)
        self._before = self._now = _Stride(STAND, settings.find(STAND), 0.0, 0)
        self._switched = 0  # stamp of the last change of stride, ns
        self._stamp: int | None = None
        self._heading = 0.0

    def request(self, gait: str, velocity: Array) -> None:
        """Ask for a gait and a velocity [v_x, v_y, yaw rate] (m/s, rad/s) in base_link.

        Raises ConfigError when the gait is unknown or the velocity outside of what it reaches.
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
        self._wanted, self._velocity = gait, np.array(velocity, dtype=float)
        self._commanded: int | None = None  # stamp of the velocity, ns; None: it does not expire

    def command(self, stamp: int, velocity: Array) -> None:
        """Ask the present gait for a velocity; it falls to zero unless renewed in time.

        `stamp` (ns) is on the clock of the states. Raises ConfigError as `request` does, and for a
        stamp too far from the last state's, which stops the robot: it may have been meant to.
        """
        self.request(self._wanted, velocity)
        self._commanded = stamp
        if self._stamp is not None and self._is_expired(self._stamp):
            raise config.ConfigError(
                f"stamp is {(stamp - self._stamp) * 1e-9:+.3f} s from the state's (limit "
                f"{self._settings.command_timeout:g} s), velocity set to zero"
            )

    def step(self, stamp: int, state: Array) -> GaitPreview:
        """Preview from `stamp` (ns) on; `state` (12,) places the reference."""
        if self._is_expired(stamp):
            self._velocity = np.zeros(3)
        self._turn(stamp, state)
        self._change_stride(stamp)
        times = self._settings.dt * np.arange(self._settings.stages, dtype=float)
        angle, load, sway = np.split(self._blend(stamp, times), [4, 8], axis=1)
        now = self._now
        return GaitPreview(
            stamp=stamp,
            gait=now.name,
            phase=float(now.phase(stamp, times)[0]),
            period=now.gait.period,
            dt=self._settings.dt,
            contact=load >= self._settings.contact_force,
            friction=np.full(load.shape, self._settings.friction),
            normal_force=load,
            tendon_angle=angle,
            reference=reference(state, self._heading, self._velocity, sway, times),
        )

    def _is_expired(self, stamp: int) -> bool:
        """Whether the velocity is too old at `stamp` (ns), or from a future that may never come."""
        if self._commanded is None:
            return False
        return abs(stamp - self._commanded) > self._settings.command_timeout * 1e9

    def _turn(self, stamp: int, state: Array) -> None:
        """Heading of the reference: the robot's at first, then the integral of the yaw rate."""
        if self._stamp is None:
            self._heading, self._switched = float(state[2]), stamp - self._transition
        else:
            self._heading += self._velocity[2] * (stamp - self._stamp) * 1e-9
        self._stamp = stamp
        self._switched = min(self._switched, stamp)  # a clock set back must not hold a change up

    def _change_stride(self, stamp: int) -> None:
        gait = self._settings.find(self._wanted)
        amplitude = gait.amplitude_at(self._velocity[0])
        unchanged = (self._wanted, amplitude) == (self._now.name, self._now.amplitude)
        if unchanged or stamp - self._switched < self._transition:
            return
        origin = self._now.origin if self._wanted == self._now.name else stamp
        self._before, self._switched = self._now, stamp
        self._now = _Stride(self._wanted, gait, amplitude, origin)

    def _blend(self, stamp: int, times: Array) -> Array:
        """(n, 20) course, from the stride before to the one now."""
        elapsed = (stamp - self._switched) * 1e-9 + times
        weight = np.clip(elapsed / max(self._settings.transition, 1e-9), 0.0, 1.0)[:, None]
        now = self._now.course(stamp, times)
        if weight.min() == 1.0:
            return now
        return (1 - weight) * self._before.course(stamp, times) + weight * now

    @property
    def _transition(self) -> int:
        return round(self._settings.transition * 1e9)


def read_gaits() -> GaitSettings:
    """The gaits of `config/gait.yaml`; raises ConfigError."""
    return config.read(GaitSettings, "gait")
