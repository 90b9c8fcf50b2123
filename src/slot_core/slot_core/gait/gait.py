"""Gaits: postures and strides, and the preview of one over the MPC's horizon.

A posture holds the torso at a height, roll and pitch; its tendon angles are those at which the legs
at rest carry an equal share of the weight there (`leg_table.py`).

A stride is periodic. Around its centre it is the sum of three patterns, forward, lateral and turn,
each scaled by an amplitude. With the phase p = 2 pi t / T, each leg's tendon angle is

    theta = centre + offset + sum_j a_j (m + c1 cos p + s1 sin p + c2 cos 2p + s2 sin 2p)_j,

clipped to the range of the gait. A negative amplitude takes the pattern's mirror image: legs front
and rear (forward) or left and right (lateral, turn) exchanged, half a stride later. The robot is
symmetric, so that one pattern serves both directions, and the velocities of the patterns add up.
Beyond its largest amplitude a pattern is no faster, since the servos are not; the amplitudes of a
blend are scaled down to |a_j / a_j,max| <= 1 (the Euclidean norm over j).
A robot that moves forward or sideways turns by the steering pattern of that direction, a small
change of its angles that alters the yaw rate alone; in place it turns by the pattern `turn`.
`scripts/tune` finds the patterns; the normal forces and the sway of the torso that result on the
simulated robot are tabulated in the same form.

Reference of the torso: where the robot is to be, and the rows of the preview.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slot_core import config
from slot_core.arrays import Array
from slot_core.compiled import helper, kernel
from slot_core.config import choice, flag, quantity
from slot_core.elementary import cos, sin
from slot_core.geometry import rotate, wrapped
from slot_core.legs.fingerprint import misfit
from slot_core.matrices import norm
from slot_core.refusal import nearest, quoted
from slot_core.robot import RobotParameters

STAND = "stand"  # name of the posture at the start
Harmonics = tuple[float, float, float, float, float]
FourHarmonics = tuple[Harmonics, Harmonics, Harmonics, Harmonics]
Four = tuple[float, float, float, float]
Vector3 = tuple[float, float, float]

# Legs after the exchange of front and rear, and of left and right.
FRONT_REAR, LEFT_RIGHT = [2, 3, 0, 1], [1, 0, 3, 2]
HALF_STRIDE_LATER = np.array([1.0, -1.0, -1.0, 1.0, 1.0])
"""Factors of m, c1, s1, c2, s2 that delay a series by half a stride."""
SPEED_NAMES = ("v_x", "v_y", "yaw rate")
ROUNDING = 1e-9  # m/s, rad/s
TINY = 1e-12  # m/s, rad/s: no velocity
TORSO_MOTION = ("roll", "pitch", "height", "v_x", "v_y")


def harmonics(phase: Array) -> Array:
    """Constant and harmonics 1, cos p, sin p, cos 2p, sin 2p (n, 5), p = 2 pi phase, phases (n,)."""
    p = 2 * np.pi * phase
    return np.column_stack(
        [np.ones_like(p), cos(p), sin(p), cos(2 * p), sin(2 * p)]
    )


class StrideTables(NamedTuple):
    """Numbers of a stride for its kernel; coefficients in the rows of `Pattern.table`."""

    rest: Array  # (13, 5)
    # (5, 2, 13, 5) of forward, lateral, turn and both steerings, and of their mirror images
    patterns: Array
    speeds: Array  # (3,) of the patterns at amplitude one, m/s, rad/s
    amplitude_max: Array  # (3,)
    steering: Array  # (2, 2) rad/s, rate at amplitude one and largest rate
    walking_speed: float  # m/s
    period: float  # s
    range: Array  # (2,) rad, of the tendon angles


@helper
def _amplitudes(stride, velocity):  # type: ignore[no-untyped-def]
    """Amplitudes (5) of the patterns and their steering at a velocity (3,)."""
    speeds, most = stride.speeds, stride.amplitude_max
    v_x, v_y, rate = velocity[0], velocity[1], velocity[2]
    x, y = v_x / speeds[0], v_y / speeds[1]
    size = max(abs(x) + abs(y), 1e-9)
    walking = min(1.0, math.sqrt(v_x * v_x + v_y * v_y) / stride.walking_speed)
    turn = rate / speeds[2] * (1.0 - walking)
    a, b, c = x / most[0], y / most[1], turn / most[2]
    limit = max(1.0, math.sqrt(a * a + b * b + c * c))
    one, other = stride.steering[0], stride.steering[1]
    forward = min(max(rate, -one[1]), one[1]) / one[0]
    lateral = min(max(rate, -other[1]), other[1]) / other[0]
    return (
        x / limit,
        y / limit,
        turn / limit,
        walking * forward * abs(x) / size,
        walking * lateral * abs(y) / size,
    )


@kernel
def _stride_table(stride, phase, velocity, offset, out):  # type: ignore[no-untyped-def]
    """Write `Stride.stride_table` (n, 20) at phases (n,), velocities (n, 3) or (1, 3)."""
    patterns, turn = stride.patterns, 2.0 * math.pi
    for i in range(phase.size):
        at = velocity[min(i, velocity.shape[0] - 1)]
        x, y, r, steer_x, steer_y = _amplitudes(stride, at)
        # a negative amplitude takes the mirror image
        back, right, left = int(x < 0.0), int(y < 0.0), int(r < 0.0)
        p = turn * phase[i]
        c, s, c2, s2 = cos(p), sin(p), cos(2.0 * p), sin(2.0 * p)
        basis = (1.0, c, s, c2, s2)
        slope = (
            0.0,
            turn * -s,
            turn * c,
            turn * (-2.0 * s2),
            turn * (2.0 * c2),
        )
        integral = (0.0, s / turn, -c / turn, s2 / 2.0 / turn, -c2 / 2.0 / turn)
        for row in range(13):
            value = change = sway = 0.0
            for k in range(5):
                factor = stride.rest[row, k] + (
                    abs(x) * patterns[0, back, row, k]
                    + abs(y) * patterns[1, right, row, k]
                    + abs(r) * patterns[2, left, row, k]
                    + steer_x * patterns[3, back, row, k]
                    + steer_y * patterns[4, right, row, k]
                )
                value += factor * basis[k]
                change += factor * slope[k]
                sway += factor * integral[k]
            if row < 4:
                low, high = stride.range[0], stride.range[1]
                out[i, row] = min(max(value + offset, low), high)
            elif row < 8:
                out[i, row] = max(value, 0.0)
            elif row < 11:
                out[i, (8, 9, 13)[row - 8]] = value
                out[i, (14, 15, 19)[row - 8]] = change / stride.period
            else:
                out[i, 6 + row] = value
                out[i, row] = sway * stride.period


@dataclass(frozen=True)
class Pattern:
    """Periodic pattern at amplitude one; coefficients in the order m, c1, s1, c2, s2.

    The tables are differences to the stride's centre at rest; legs in the order FL FR RL RR.
    """

    speed: float = quantity(
        "velocity commanded by amplitude one", "m/s or rad/s", 1e-3, 1
    )
    angle_deg: FourHarmonics = quantity("tendon angle", "deg", -360, 360)
    normal_force: FourHarmonics = quantity(
        "normal force of the ground", "N", -50, 50
    )
    roll: Harmonics = quantity("roll of the torso", "rad", -1, 1)
    pitch: Harmonics = quantity("pitch of the torso", "rad", -1, 1)
    height: Harmonics = quantity("height of base_link", "m", -0.2, 0.2)
    v_x: Harmonics = quantity("forward velocity about its mean", "m/s", -1, 1)
    v_y: Harmonics = quantity("lateral velocity about its mean", "m/s", -1, 1)

    @cached_property
    def table(self) -> Array:
        """Coefficients (13, 5): 4 tendon angles (rad), 4 normal forces, TORSO_MOTION."""
        return np.vstack(
            [
                np.radians(self.angle_deg),
                self.normal_force,
                [getattr(self, name) for name in TORSO_MOTION],
            ]
        )


@dataclass(frozen=True)
class Steering:
    """Change of a pattern's tendon angles that alters the yaw rate alone."""

    rate: float = quantity("yaw rate at amplitude one", "rad/s", 1e-4, 1)
    rate_max: float = quantity("largest yaw rate", "rad/s", 1e-4, 1)
    angle_deg: FourHarmonics = quantity(
        "change of the tendon angle", "deg", -45, 45
    )

    @cached_property
    def table(self) -> Array:
        """Coefficients (13, 5) in the rows of `Pattern.table`."""
        return np.vstack([np.radians(self.angle_deg), np.zeros((9, 5))])


@dataclass(frozen=True)
class Posture:
    """Torso at rest."""

    kind: str = choice("kind of the gait", "posture")
    loaded: bool = flag(
        "whether the legs carry the torso; else the tendons are slack"
    )
    height: float = quantity("height of base_link", "m", 0.015, 0.12)
    roll_deg: float = quantity("roll", "deg", -20, 20)
    pitch_deg: float = quantity("pitch", "deg", -20, 20)
    height_range: tuple[float, float] = quantity(
        "heights that can be commanded", "m", 0.015, 0.12
    )

    cruise = 0.0
    period = 1.0
    speeds = (0.0, 0.0, 0.0)

    def share_reached(self, velocity: Array) -> float:
        """Largest factor, at most 1, with which a velocity (3,) is reached."""
        return 0.0 if velocity.any() else 1.0


@dataclass(frozen=True)
class Stride:
    """Periodic gait: centre and patterns."""

    forward: Pattern
    lateral: Pattern
    turn: Pattern
    forward_steering: Steering
    lateral_steering: Steering
    kind: str = choice("kind of the gait", "stride")
    period: float = quantity("duration of a stride", "s", 0.1, 10.0)
    cruise: float = quantity("v_x if none is requested", "m/s", -1, 1)
    centre_deg: Four = quantity("tendon angle at rest", "deg", 0, 120)
    range_deg: tuple[float, float] = quantity(
        "range to which tendon angles are clipped", "deg", 0, 120
    )
    centre_force: float = quantity("normal force of a leg at rest", "N", 0, 50)
    height: float = quantity("height of base_link at rest", "m", 0.015, 0.12)
    height_range: tuple[float, float] = quantity(
        "heights that can be commanded", "m", 0.015, 0.12
    )
    amplitude_max: Vector3 = quantity(
        "largest amplitude of each pattern alone", "", 0.1, 3
    )
    walking_speed: float = quantity(
        "speed above which steering replaces the turn", "m/s", 1e-3, 1
    )

    yields: float = quantity(
        "share of the height that legs of another stiffness give in, or rise; the rest is held",
        "",
        0.0,
        1.0,
    )

    @property
    def speeds(self) -> Vector3:
        """Largest v_x, v_y (m/s) and yaw rate (rad/s) that can be requested, one at a time."""
        return (self.forward.speed, self.lateral.speed, self.turn.speed)

    def reached(self, velocity: Array) -> Array:
        """The velocity (3,), scaled, its yaw rate clipped, to what the patterns reach together."""
        share = velocity[:2] / self.speeds[:2] / self.amplitude_max[:2]
        planar = velocity[:2] / max(1.0, norm(share))
        # weight of steering; the rest is that of `turn`
        walking = min(1.0, norm(planar) / self.walking_speed)
        steering = min(
            self.forward_steering.rate_max, self.lateral_steering.rate_max
        )
        most = (1.0 - walking) * self.turn.speed + walking * steering
        return np.append(planar, np.clip(velocity[2], -most, most))

    def share_reached(self, velocity: Array) -> float:
        """Largest factor s, at most 1, with which s times a velocity (3,) is reached.

        With v = |v_x, v_y| the yaw rate has to stay below the line from `turn` at s v = 0 to the
        steering's rate at `walking_speed`, or below that rate beyond it.
        """
        sizes, speed = np.abs(velocity), norm(velocity[:2])
        planar = norm(velocity[:2] / self.speeds[:2] / self.amplitude_max[:2])
        steering = min(
            self.forward_steering.rate_max, self.lateral_steering.rate_max
        )
        slope = (self.turn.speed - steering) / self.walking_speed
        turning = self.turn.speed / max(sizes[2] + slope * speed, TINY)
        if turning * speed > self.walking_speed:
            turning = steering / max(sizes[2], TINY)
        alone = np.min(self.speeds / np.maximum(sizes, TINY))
        share = float(min(1.0 / max(planar, TINY), turning, alone))
        return share if share < 1.0 - ROUNDING else 1.0

    def stride_table(
        self, phase: Array, velocity: Array, offset: float = 0.0
    ) -> Array:
        """Gait (n, 20) at phases (n,): 4 tendon angles (rad), 4 normal forces (N), 12 torso states.

        velocity: (n, 3) or (3,) [v_x, v_y, yaw rate] that sets the amplitudes; offset: rad, of all
        angles. Torso states in the heading frame: [roll pitch 0, sway of x and y, z, omega, v],
        omega to first order in the angles; the sway is the integral of v over the phase.
        """
        out = np.zeros((len(phase), 20))
        # copies: of one type for the kernel
        at = np.array(phase, dtype=float)
        moving = np.array(velocity, dtype=float, order="C", ndmin=2)
        _stride_table(self._tables, at, moving, float(offset), out)
        return out

    @cached_property
    def _tables(self) -> StrideTables:
        front_rear = np.array([1.0, -1.0, 1.0, -1.0, 1.0])  # signs of the sway
        left_right = np.array([-1.0, 1.0, 1.0, 1.0, -1.0])
        # The mirror image of a left turn is a right turn, hence the sign.
        pairs = [
            (part.table, sign * _mirrored(part.table, legs, signs))
            for part, legs, signs, sign in (
                (self.forward, FRONT_REAR, front_rear, 1.0),
                (self.lateral, LEFT_RIGHT, left_right, 1.0),
                (self.turn, LEFT_RIGHT, left_right, 1.0),
                (self.forward_steering, FRONT_REAR, np.ones(5), -1.0),
                (self.lateral_steering, LEFT_RIGHT, np.ones(5), -1.0),
            )
        ]
        steerings = (self.forward_steering, self.lateral_steering)
        rest = np.zeros((13, 5))
        rest[:4, 0] = np.radians(self.centre_deg)
        rest[4:8, 0] = self.centre_force
        rest[10, 0] = self.height
        return StrideTables(
            rest,
            np.array(pairs),
            np.array(self.speeds),
            np.array(self.amplitude_max),
            np.array([(one.rate, one.rate_max) for one in steerings]),
            self.walking_speed,
            self.period,
            np.radians(self.range_deg),
        )


def _mirrored(table: Array, legs: list[int], signs: Array) -> Array:
    """Mirror image of a pattern (13, 5), half a stride later; signs (5,) of the sway."""
    parts = [table[:4][legs], table[4:8][legs], signs[:, None] * table[8:]]
    return np.vstack(parts) * HALF_STRIDE_LATER


@dataclass(frozen=True)
class GaitSettings:
    """Settings of `config/gait.yaml`, and the gaits of `config/gait/`."""

    postures: dict[str, Posture]
    strides: dict[str, Stride]
    friction: float = quantity(
        "friction coefficient assumed by the controller", "", 0, 2
    )
    contact_force: float = quantity(
        "smallest normal force of a leg in stance", "N", 0, 10
    )
    transition: float = quantity(
        "duration of a blend between gaits", "s", 0, 10
    )
    acceleration: float = quantity(
        "largest rate of change of the commanded velocity", "m/s^2", 1e-3, 10
    )
    turn_acceleration: float = quantity(
        "largest rate of change of the commanded yaw rate", "rad/s^2", 1e-3, 10
    )
    lead: float = quantity(
        "largest distance of the reference from the robot", "m", 0, 1
    )
    heading_lead: float = quantity(
        "largest angle of the reference from the robot", "rad", 0, 1
    )
    lift_speed: float = quantity(
        "largest rate of change of the commanded height", "m/s", 1e-3, 1
    )
    tilt_speed: float = quantity(
        "largest rate of change of commanded roll and pitch", "rad/s", 1e-3, 10
    )
    tilt_max: float = quantity(
        "largest commanded roll and pitch", "rad", 0, 0.5
    )
    velocity_timeout: float = quantity(
        "age at which a velocity command expires", "s", 0.05, 10
    )
    soft: tuple[float, float] = quantity(
        "leg stiffness ratios between which a stride's speed grows from zero to its own",
        "",
        0.1,
        1.0,
    )
    stages: int = quantity(
        "stages of the preview, at least the MPC's horizon", "", 1, 100
    )
    dt: float = quantity("time between stages", "s", 1e-3, 0.2)

    @cached_property
    def gaits(self) -> dict[str, Posture | Stride]:
        """All gaits by name."""
        return {**self.postures, **self.strides}

    def find(self, name: str) -> Posture | Stride:
        """The gait of that name; raises ConfigError for an unknown one and names the nearest."""
        if name not in self.gaits:
            raise config.ConfigError(
                f"no gait {quoted(name)}{nearest(name, sorted(self.gaits))}"
            )
        return self.gaits[name]

    def clipped(self, name: str, velocity: Array) -> tuple[Array, str]:
        """The velocity (3,), as fast as a gait follows it, and a line on what was clipped, or "".

        All three are scaled alike, so that the robot keeps the curve. Raises ConfigError for an
        unknown gait, or a velocity that is not finite or not (3,).
        """
        gait, wanted = self.find(name), np.array(velocity, dtype=float)
        if wanted.shape != (3,) or not np.isfinite(wanted).all():
            raise config.ConfigError(
                f"velocity {wanted}: expected three finite numbers"
            )
        share = gait.share_reached(wanted)
        if share == 1.0:
            return wanted, ""
        changes = ", ".join(
            f"{label} {v:.3g} to {share * v:.3g}"
            for label, v in zip(SPEED_NAMES, wanted)
            if v
        )
        return (
            share * wanted,
            f"velocity clipped to the reach of gait {name}: {changes}",
        )

    def share_reached(
        self, name: str, velocity: Array, stiffness: float
    ) -> float:
        """Share, at most 1, of a velocity (3,) that a gait reaches on legs of a stiffness ratio.

        On legs softer than `soft[1]` a stride is slower; at `soft[0]` it only stands.
        """
        gait, (least, full) = self.find(name), self.soft
        share = min(1.0, max(0.0, (stiffness - least) / (full - least)))
        if share == 1.0 or isinstance(gait, Posture):
            return 1.0
        return share and gait.share_reached(velocity / share)

    def require_velocity(self, name: str, velocity: Array) -> None:
        """Raise ConfigError for an unknown gait or a velocity (3,) that it does not reach."""
        gait = self.find(name)
        if len(velocity) != 3:
            raise config.ConfigError(
                f"velocity: {len(velocity)} values, not v_x, v_y, yaw rate"
            )
        for value, most, label in zip(velocity, gait.speeds, SPEED_NAMES):
            if not abs(value) <= most + ROUNDING:
                raise config.ConfigError(
                    f"{label} = {value:g}: gait {name} reaches [{0.0 - most:g}, {most:g}]"
                )
        if isinstance(gait, Stride):
            for value, reached, label in zip(
                velocity, gait.reached(velocity), SPEED_NAMES
            ):
                if abs(value - reached) > ROUNDING:
                    raise config.ConfigError(
                        f"{label} = {value:g}: with the other velocities gait {name} reaches"
                        f" {reached:.4g}"
                    )

    def require_pose(self, name: str, pose: Array) -> None:
        """Raise ConfigError for a body pose (3,) height, roll, pitch that a gait does not reach."""
        gait = self.find(name)
        if isinstance(gait, Posture) and not gait.loaded:
            raise config.ConfigError(
                f"gait {name} has slack tendons: no body pose"
            )
        tilts = (-self.tilt_max, self.tilt_max)
        for label, value, (least, most) in zip(
            ("height", "roll", "pitch"),
            pose,
            (gait.height_range, tilts, tilts),
        ):
            if not least <= value <= most:
                raise config.ConfigError(
                    f"{label} = {value:g}: gait {name} reaches [{least:g}, {most:g}]"
                )


@dataclass(frozen=True)
class GaitCommand:
    """Gait, velocity and body pose that are commanded, and whether the servos follow."""

    gait: str
    velocity: Array  # (3,) v_x, v_y m/s, yaw rate rad/s in base_link
    pose: Array  # (3,) height m, roll, pitch rad
    followed: bool = True


@dataclass(frozen=True)
class GaitPreview:
    """Preview of contact, friction, angles and reference at the stages 0 .. n-1 of the horizon.

    `stamp` is the state's; stage k is k dt after the time to which the state is predicted.
    Legs in the order FL FR RL RR, frame odom.
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
    velocity_ahead: Array  # (n, 3) v_x, v_y m/s, yaw rate rad/s of the reference, heading frame
    # whether a policy may correct the angles: loaded legs follow them
    corrected: bool
    command: GaitCommand  # that was in force
    # one line on a command that is followed in part only, or not at all
    remark: str = ""
    leg_stiffness: float = 1.0  # ratio kappa of the legs (`leg_table.py`)

    @property
    def in_place(self) -> bool:
        """Whether the robot is to turn without moving."""
        return (self.velocity_ahead[0] != 0.0).tolist() == [False, False, True]

    @property
    def phases(self) -> Array:
        """(n,) of the stages, in [0, 1)."""
        ahead = self.dt * np.arange(len(self.tendon_angle)) / self.period
        return np.asarray((self.phase + ahead) % 1.0)

    @property
    def rate(self) -> Array:
        """(4,) rad/s, of the nominal tendon angles from stage 0 to stage 1; zero without it."""
        return first_rate(np.asarray(self.tendon_angle, dtype=float), self.dt)


def first_rate(angle: Array, dt: float) -> Array:
    """Rate (4,) rad/s of angles (n, 4) from stage 0 to stage 1, dt (s) later; zero without it."""
    return np.asarray(
        (angle[1] - angle[0]) / dt if len(angle) > 1 else np.zeros(4)
    )


def read_gaits() -> GaitSettings:
    """The settings of `config/gait.yaml` with every file of `config/gait/`; raises ConfigError."""
    settings = config.load("gait")
    if not isinstance(settings, dict):
        raise config.ConfigError(
            f"gait.yaml: expected a mapping, got {quoted(settings)}"
        )
    found: dict[str, dict[str, object]] = {"posture": {}, "stride": {}}
    for path in sorted((config.config_dir() / "gait").glob("*.yaml")):
        gait = config.load(f"gait/{path.stem}")
        kind = gait.get("kind") if isinstance(gait, dict) else None
        if not isinstance(kind, str) or kind not in found:
            raise config.ConfigError(
                f"gait/{path.name}: kind = {quoted(kind)}: expected one of {', '.join(found)}"
            )
        gait.pop("made_for", None)
        found[kind][path.stem] = gait
    return config.build(
        GaitSettings,
        settings | {"postures": found["posture"], "strides": found["stride"]},
        where="gait.yaml",
    )


def gait_misfit(name: str, robot: RobotParameters) -> str:
    """One line on a stride that was made for another robot, or does not say for which, or "".

    It walks, on the leg map of the robot, but with other speeds, forces and sway than its tables
    say. Raises ConfigError.
    """
    gait = config.load(f"gait/{name}")
    if gait.get("kind") == "posture":
        return ""
    return misfit(gait.get("made_for"), robot, f"gait/{name}.yaml")


def moved(place: Array, velocity: Array, dt: float) -> Array:
    """Places (..., 3) x, y (m), yaw (rad) after dt (s) at velocities (..., 3), heading frame."""
    along = rotate(velocity[..., :2], place[..., 2])
    return np.asarray(
        place + dt * np.concatenate([along, velocity[..., 2:]], axis=-1)
    )


def limited(
    place: Array, robot: Array, lead: float, heading_lead: float
) -> Array:
    """Reference place (3,), at most `lead` (m) and `heading_lead` (rad) from the robot's place."""
    gap, turn = place[:2] - robot[:2], wrapped(place[2] - robot[2])
    share = min(1.0, lead / max(norm(gap), 1e-12))
    led = min(max(turn, -heading_lead), heading_lead)
    return np.array([*(robot[:2] + share * gap), robot[2] + led])


def places_ahead(place: Array, velocity: Array, dt: float) -> Array:
    """Places (n, 3) from `place` (3,) on at velocities (n, 3) of stages dt (s) long."""
    yaw = place[2] + dt * np.append(0.0, np.cumsum(velocity[:-1, 2]))
    steps = dt * rotate(velocity[:-1, :2], yaw[:-1])
    xy = place[:2] + np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.column_stack([xy, yaw])


def reference(
    state: Array, place: Array, velocity: Array, motion: Array
) -> Array:
    """Reference (n, 12) [roll pitch yaw, p, omega, v] in odom.

    place: (n, 3) x, y (m) and yaw (rad) of the reference place; velocity: (n, 3) [v_x, v_y, yaw
    rate] (m/s, rad/s) in its heading frame; motion: (n, 12), the gait's own, in that frame, is
    added. The yaw is shifted by the full turns that bring it nearest to the state's.
    """
    yaw = place[:, 2] + 2 * np.pi * np.round(
        (state[2] - place[0, 2]) / (2 * np.pi)
    )
    rows = motion.copy()
    rows[:, 2] = yaw
    along = motion[:, 9:11] + velocity[:, :2]
    rows[:, 6:8], rows[:, 9:11], sway = rotate(
        np.array([motion[:, 6:8], along, motion[:, 3:5]]), yaw
    )
    rows[:, 8] = velocity[:, 2]
    rows[:, 3:5] = place[:, :2] + sway
    return rows


def mean_velocity(time: Array, pose: Array) -> Array:
    """Mean velocity (3,) [v_x, v_y, yaw rate] (m/s, rad/s) of a track, in base_link.

    time: (n,) s; pose: (n, 3) x, y (m) and yaw (rad) in odom; the yaw may wrap.
    """
    yaw = np.unwrap(pose[:, 2])
    forward, lateral = rotate(np.diff(pose[:, :2], axis=0), -yaw[:-1]).T
    return np.array([forward.sum(), lateral.sum(), yaw[-1] - yaw[0]]) / (
        time[-1] - time[0]
    )
