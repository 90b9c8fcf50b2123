"""Gaits: nominal tendon angles, contact schedule and load of the legs over the horizon.

A gait is periodic. With the phase p = 2 pi t / T, each leg's tendon angle is
theta = m + c1 cos p + s1 sin p + c2 cos 2p + s2 sin 2p, clipped to the gait's range; the normal
force that the ground returns is tabulated in the same form.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slot_core import config
from slot_core.config import quantity
from slot_core.control.reference import reference
from slot_core.robot import Array

Harmonics = tuple[float, float, float, float, float]
FourHarmonics = tuple[Harmonics, Harmonics, Harmonics, Harmonics]


@dataclass(frozen=True)
class Gait:
    """One periodic gait; coefficients in the order m, c1, s1, c2, s2, legs FL FR RL RR."""

    period: float = quantity("duration of a stride", "s", 0.1, 10.0)
    height: float = quantity("mean height of base_link", "m", 0.01, 0.15)
    speed: tuple[float, float] = quantity("least and greatest v_x that may be asked", "m/s", -1, 1)
    amplitude: tuple[float, float] = quantity("scale of the harmonics at these speeds", "", 0, 1)
    angle_deg: FourHarmonics = quantity("tendon angle", "deg", -360, 360)
    range_deg: tuple[float, float] = quantity("clip of the tendon angle", "deg", 0, 116.28)
    normal_force: FourHarmonics = quantity("normal force of the ground", "N", -50, 50)

    def amplitude_at(self, speed: float) -> float:
        """Scale of the harmonics for a forward speed (m/s), linear between the limits."""
        return float(np.interp(speed, self.speed, self.amplitude))

    def angles(self, phase: Array, amplitude: float) -> Array:
        """(n, 4) tendon angles, rad, at phases (n,) in [0, 1)."""
        angle_deg = harmonics(self.angle_deg, phase, amplitude)
        return np.radians(np.clip(angle_deg, *self.range_deg))

    def loads(self, phase: Array, amplitude: float) -> Array:
        """(n, 4) normal forces, N, never negative."""
        return np.maximum(harmonics(self.normal_force, phase, amplitude), 0.0)


@dataclass(frozen=True)
class GaitSettings:
    """What `config/gait.yaml` holds."""

    friction: float = quantity("coefficient the controller counts on", "", 0, 2)
    contact_force: float = quantity("least load of a leg that counts as stance", "N", 0, 10)
    transition: float = quantity("time from one gait to the next", "s", 0, 10)
    command_timeout: float = quantity("age at which a velocity command expires", "s", 0.05, 10)
    stages: int = quantity("stages of the preview, at least the MPC's horizon", "", 1, 100)
    dt: float = quantity("time between stages", "s", 1e-3, 0.2)
    gaits: dict[str, Gait] = field(metadata={"doc": "gaits by name"})

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


def harmonics(coefficients: FourHarmonics, phase: Array, amplitude: float) -> Array:
    """(n, 4) m + amplitude (c1 cos p + s1 sin p + c2 cos 2p + s2 sin 2p), p = 2 pi phase."""
    p = 2 * np.pi * np.asarray(phase)
    basis = np.column_stack([np.cos(p), np.sin(p), np.cos(2 * p), np.sin(2 * p)])
    table = np.array(coefficients)
    return table[:, 0] + amplitude * basis @ table[:, 1:].T


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

    def angles_and_loads(self, stamp: int, times: Array) -> Array:
        """(2, n, 4) tendon angles, rad, and normal forces, N."""
        phase = self.phase(stamp, times)
        return np.stack(
            [self.gait.angles(phase, self.amplitude), self.gait.loads(phase, self.amplitude)]
        )


class GaitScheduler:
    """Keeps the phase of the gait and previews the horizon at every tick of the controller.

    Gaits follow each other by a linear blend over `transition` seconds; a request made meanwhile
    waits until it is over. A run starts from the gait `stand`.
    """

    def __init__(self, settings: GaitSettings, gait: str, velocity: Array):
        """Go from `stand` to `gait` at velocity [v_x, v_y, yaw rate] from the first tick on.

        Raises ConfigError for an unknown gait or a velocity it cannot reach.
        """
        self._settings = settings
        self.request(gait, velocity)
        self._before = self._now = _Stride("stand", settings.find("stand"), 0.0, 0)
        self._switched = 0  # stamp of the last change of stride, ns
        self._stamp: int | None = None
        self._heading = 0.0

    def request(self, gait: str, velocity: Array) -> None:
        """Ask for a gait and a velocity [v_x, v_y, yaw rate] (m/s, rad/s) in base_link.

        Raises ConfigError when the gait is unknown or the velocity outside of what it reaches.
        """
        low, high = self._settings.find(gait).speed
        limits = (("v_x", low, high), ("v_y", 0.0, 0.0), ("yaw rate", 0.0, 0.0))
        for value, (name, least, most) in zip(velocity, limits):
            if not least <= value <= most:
                raise config.ConfigError(
                    f"{name} = {value:g}: gait {gait} reaches [{least:g}, {most:g}]"
                )
        self._wanted, self._velocity = gait, np.array(velocity, dtype=float)
        self._expiry: int | None = None

    def command(self, stamp: int, velocity: Array) -> None:
        """Ask the present gait for a velocity; it falls to zero unless renewed in time.

        `stamp` (ns) is on the clock of the states. Raises ConfigError as `request` does.
        """
        self.request(self._wanted, velocity)
        self._expiry = stamp + round(self._settings.command_timeout * 1e9)

    def step(self, stamp: int, state: Array) -> GaitPreview:
        """Preview from `stamp` (ns) on; `state` (12,) places the reference."""
        if self._expiry is not None and stamp > self._expiry:
            self._velocity = np.zeros(3)
        self._turn(stamp, state)
        self._change_stride(stamp)
        times = self._settings.dt * np.arange(self._settings.stages, dtype=float)
        angle, load = self._blend(stamp, times)
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
            reference=reference(state, self._heading, now.gait.height, self._velocity, times),
        )

    def _turn(self, stamp: int, state: Array) -> None:
        """Heading of the reference: the robot's at first, then the integral of the yaw rate."""
        if self._stamp is None:
            self._heading, self._switched = float(state[2]), stamp - self._transition
        else:
            self._heading += self._velocity[2] * (stamp - self._stamp) * 1e-9
        self._stamp = stamp

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
        """(2, n, 4) angles and loads, from the stride before to the one now."""
        elapsed = (stamp - self._switched) * 1e-9 + times
        weight = np.clip(elapsed / max(self._settings.transition, 1e-9), 0.0, 1.0)[:, None]
        before = self._before.angles_and_loads(stamp, times)
        return (1 - weight) * before + weight * self._now.angles_and_loads(stamp, times)

    @property
    def _transition(self) -> int:
        return round(self._settings.transition * 1e9)


def read_gaits() -> GaitSettings:
    """The gaits of `config/gait.yaml`; raises ConfigError."""
    return config.read(GaitSettings, "gait")
