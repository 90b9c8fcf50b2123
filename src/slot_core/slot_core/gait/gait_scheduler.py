"""Gait scheduler: advances the gait with the state's stamps and previews the MPC's horizon."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import to_seconds
from slot_core.config import ConfigError
from slot_core.gait.gait import (
    STAND,
    GaitCommand,
    GaitPreview,
    GaitSettings,
    Posture,
    Stride,
    limited,
    moved,
    places_ahead,
    reference,
)
from slot_core.gait.route import Route
from slot_core.geometry import wrapped
from slot_core.key_frame import StateParts
from slot_core.legs.leg_table import LegSprings
from slot_core.matrices import norm
from slot_core.robot import RobotParameters

# 1/s, of the legs' stiffness ratio: a change must not jerk the legs
STIFFNESS_RATE = 0.4
LEAST_VELOCITY = 1e-4  # m/s, rad/s: below it a stride stands
# s between states; after a longer one the commands do not move
LONGEST_GAP = 0.5
SETTLING = 0.5  # s that the servos follow before a posture is corrected: the torso still swings
# m/s, rad/s of a torso; beyond it the odometry has jumped
FASTEST, FASTEST_TURN = 1.0, 3.0


@dataclass
class _Active:
    """A posture that is held, or a stride that runs."""

    name: str
    gait: Posture | Stride
    phase: float = 0.0  # of a stride, in [0, 1)
    moving: float = 1.0  # share of the stride against standing on its centre


class GaitScheduler:
    """Runs a gait at a commanded velocity and body pose.

    Velocity and body pose follow their commands at limited rates. A change of gait is a linear
    blend of the tendon angles over `transition` seconds; a request during a blend takes effect at
    its end. A run starts from the posture `stand`. A stride without velocity stands on its centre;
    it gets there, and back, by a blend as well. While the servos do not follow the commands a stride
    stands on its centre, its phase waits, and no policy corrects anything; then it blends from there.
    The reference place moves with the velocity, or along the path, at most `lead` ahead of the
    robot; once a stride stands it is the robot's.
    """

    STATE = StateParts(
        "_requested",
        "_wanted",
        "_remark",
        "_wanted_pose",
        "_command_stamp",
        "_running",
        "_since_change",
        "_stamp",
        "_seen",
        "_followed",
        "_followed_for",
        "_velocity",
        "_pose",
        "_place",
        "_path",
        "_stiffness",
    )

    def __init__(  # noqa: PLR0917
        self,
        settings: GaitSettings,
        robot: RobotParameters,
        springs: LegSprings,
        gait: str,
        velocity: Array | None,
        path: Route | None = None,
    ):
        """Blend from `stand` to `gait` at velocity [v_x, v_y, yaw rate] from the first tick on.

        velocity: (3,) m/s, m/s, rad/s in base_link; None: straight ahead at the gait's `cruise`.
        path: followed by a stride at the speed of the velocity, whatever its direction. Raises
        ConfigError for an unknown gait or a velocity outside the gait's range.
        """
        self._settings, self._robot, self._springs = settings, robot, springs
        if velocity is None:
            velocity = np.array([settings.find(gait).cruise, 0.0, 0.0])
        self.request(gait, velocity)
        self._path = path
        self._current = self._previous = self._activate(STAND)
        self._since_change = settings.transition  # s
        self._stamp: int | None = None
        # (3,) x, y (m), yaw (rad) of the last state
        self._seen: Array | None = None
        self._followed = True  # whether the servos follow the commands
        self._followed_for = SETTLING  # s
        self._velocity = np.zeros(3)  # present, at limited rates
        # (3,) height, roll, pitch, present
        self._pose = self._home(self._current.gait)
        # (3,) x, y (m), yaw (rad) of the reference
        self._place: Array | None = None
        self._stiffness = 1.0  # ratio kappa of the legs, at a limited rate
        for stride in settings.strides.values():
            stride.stride_table(np.zeros(1), np.zeros(3))  # compiles, tabulates

    def request(self, gait: str, velocity: Array) -> None:
        """Request a gait and a velocity [v_x, v_y, yaw rate] (m/s, rad/s) in base_link.

        The body pose returns to the gait's own. Raises ConfigError for an unknown gait or a
        velocity outside the gait's range.
        """
        self._settings.require_velocity(gait, velocity)
        self._requested, self._wanted = gait, np.array(velocity, dtype=float)
        self._remark = ""  # what of the velocity is clipped
        self._wanted_pose = self._home(self._settings.find(gait))
        # ns, of the velocity; None: it does not expire
        self._command_stamp: int | None = None

    def set_velocity(self, stamp: int, velocity: Array) -> None:
        """Set the velocity of the requested gait; after `velocity_timeout` it becomes zero.

        stamp: ns, on the clock of the states. What the gait does not reach is clipped, in the same
        direction. Raises ConfigError for a velocity that is not finite, and for a stamp further
        than `velocity_timeout` from the last state's. Such a command stops the robot, since it may
        have been a late stop.
        """
        self._wanted, self._remark = self._settings.clipped(
            self._requested, velocity
        )
        self._command_stamp = stamp
        if self._stamp is not None and self._is_expired(self._stamp):
            self._stop()
            raise ConfigError(
                f"stamp is {to_seconds(stamp - self._stamp):+.3f} s from the state's (limit "
                f"{self._settings.velocity_timeout:g} s), velocity set to zero"
            )

    def set_pose(self, pose: Array) -> None:
        """Set height (m), roll and pitch (rad) of the torso; raises ConfigError out of range."""
        self._settings.require_pose(self._requested, pose)
        self._wanted_pose = np.array(pose, dtype=float)

    def set_followed(self, followed: bool) -> None:
        """Set whether the servos follow the commands."""
        if followed and not self._followed:
            self._followed_for = 0.0
        self._followed = followed

    def set_command(self, command: GaitCommand) -> None:
        """Set everything that is commanded, as recorded; raises ConfigError as the requests do."""
        self.request(command.gait, command.velocity)
        self._wanted_pose = np.array(command.pose, dtype=float)
        self.set_followed(command.followed)

    def step(
        self, stamp: int, state: Array, leg_stiffness: float = 1.0
    ) -> GaitPreview:
        """Preview from `stamp` (ns) on, at `state` (12,).

        leg_stiffness: ratio kappa of the legs (`leg_table.py`), followed at a limited rate.
        """
        if self._is_expired(stamp):
            self._stop()
        elapsed = (
            0.0 if self._stamp is None else to_seconds(stamp - self._stamp)
        )
        self._stamp = stamp
        if not 0.0 <= elapsed <= LONGEST_GAP:
            elapsed = 0.0
        if self._has_jumped(elapsed, state):
            self._place = None
        self._seen = state[[3, 4, 2]].copy()
        self._followed_for += elapsed
        step = elapsed * STIFFNESS_RATE
        self._stiffness += min(
            max(leg_stiffness - self._stiffness, -step), step
        )
        self._since_change += elapsed
        if (
            self._requested != self._current.name
            and self._since_change >= self._settings.transition
        ):
            self._previous, self._since_change = self._current, 0.0
            self._current = self._activate(self._requested)
        self._approach_commands(elapsed, state)
        self._stride(elapsed, state)
        return self._preview(stamp, state)

    def _stop(self) -> None:
        """Command no velocity."""
        self._wanted, self._remark = np.zeros(3), ""

    def _has_jumped(self, elapsed: float, state: Array) -> bool:
        """Whether the robot is further from where it was seen last than it can move."""
        if self._seen is None:
            return False
        # the estimates of a gap have one time, but not one place
        most = max(elapsed, self._settings.dt)
        return bool(
            norm(state[3:5] - self._seen[:2]) > FASTEST * most
            or abs(wrapped(state[2] - self._seen[2])) > FASTEST_TURN * most
        )

    def _is_expired(self, stamp: int) -> bool:
        """Whether the velocity is too old at `stamp` (ns), or too far in the future."""
        return (
            self._command_stamp is not None
            and abs(stamp - self._command_stamp)
            > self._settings.velocity_timeout * 1e9
        )

    def _activate(
        self, name: str, phase: float = 0.0, moving: float = 1.0
    ) -> _Active:
        return _Active(name, self._settings.find(name), phase, moving)

    @property
    def _running(self) -> list[list[object]]:
        """Name, phase and share of motion of the previous and of the present gait."""
        return [
            [a.name, a.phase, a.moving] for a in (self._previous, self._current)
        ]

    @_running.setter
    def _running(self, both: Sequence[Sequence[Any]]) -> None:
        self._previous, self._current = (
            self._activate(name, float(phase), float(moving))
            for name, phase, moving in both
        )

    def _home(self, gait: Posture | Stride) -> Array:
        """Height, roll and pitch (3,) of a gait without a commanded body pose."""
        if isinstance(gait, Stride):
            return np.array([gait.height, 0.0, 0.0])
        return np.array(
            [gait.height, *np.radians([gait.roll_deg, gait.pitch_deg])]
        )

    def _approach_commands(self, elapsed: float, state: Array) -> None:
        """Let velocity and body pose follow their commands at limited rates."""
        s = self._settings
        wanted = self._reachable
        gait = self._current.gait
        if self._path is not None and isinstance(gait, Stride):
            wanted = gait.reached(self._path.velocity(state, self._speed))
        self._velocity = _toward(
            self._velocity,
            wanted,
            elapsed
            * np.array([s.acceleration, s.acceleration, s.turn_acceleration]),
        )
        self._pose = self._pose_after(elapsed)

    @property
    def _speed(self) -> float:
        """Commanded speed along a path, m/s."""
        return norm(self._reachable[:2])

    @property
    def _reachable(self) -> Array:
        """Commanded velocity (3,), as fast as these legs follow it."""
        return self._share() * self._wanted

    def _share(self) -> float:
        """Share of the commanded velocity that legs of this stiffness follow."""
        return self._settings.share_reached(
            self._requested, self._wanted, self._stiffness
        )

    def _pose_after(self, time: float) -> Array:
        """Height, roll and pitch (3,) after a time (s)."""
        s = self._settings
        rates = np.array([s.lift_speed, s.tilt_speed, s.tilt_speed])
        return _toward(self._pose, self._wanted_pose, time * rates)

    def _stride(self, elapsed: float, state: Array) -> None:
        """Advance the strides that run, and the reference place."""
        for active in {
            id(a): a for a in (self._previous, self._current)
        }.values():
            if isinstance(active.gait, Stride):
                (active.moving,) = self._moving_after(
                    active, np.array([elapsed])
                ).tolist()
        current, still = self._current, self._is_still()
        # coming to rest, it stays where it was: the legs unwind and would move the robot
        stands = still and (current.moving == 0.0 or self._place is None)
        if isinstance(current.gait, Posture) or stands or not self._followed:
            self._place = None
            return
        if not still:
            current.phase = (
                current.phase + elapsed / current.gait.period
            ) % 1.0
        if self._path is not None:
            self._place = self._path.place(state, elapsed, self._speed)
        elif self._place is None:
            self._place = state[[3, 4, 2]].copy()
        else:
            self._place = moved(self._place, self._velocity, elapsed)
        s = self._settings
        self._place = limited(
            self._place, state[[3, 4, 2]], s.lead, s.heading_lead
        )

    def _is_still(self) -> bool:
        return bool((np.abs(self._velocity) < LEAST_VELOCITY).all())

    def _moving_after(self, active: _Active, times: Array) -> Array:
        """Share (n,) of a stride's motion at `times` (s) ahead."""
        if not self._followed:
            return np.zeros(len(times))
        change = times / max(self._settings.transition, 1e-9)
        return np.clip(
            active.moving + (-change if self._is_still() else change), 0.0, 1.0
        )

    def _preview(self, stamp: int, state: Array) -> GaitPreview:
        times = self._settings.dt * np.arange(
            self._settings.stages, dtype=float
        )
        current, (velocity, place) = self._current, self._ahead(times, state)
        angle, force, motion = np.split(
            self._blend(times, velocity), [4, 8], axis=1
        )
        return GaitPreview(
            stamp=stamp,
            gait=current.name,
            phase=current.phase,
            period=current.gait.period,
            dt=self._settings.dt,
            contact=force >= self._settings.contact_force,
            friction=np.full(force.shape, self._settings.friction),
            normal_force=force,
            tendon_angle=angle,
            reference=reference(state, place, velocity, motion),
            velocity_ahead=velocity,
            corrected=self._is_corrected(),
            command=GaitCommand(
                self._requested,
                self._wanted.copy(),
                self._wanted_pose.copy(),
                self._followed,
            ),
            remark=self._remark or self._soft_remark(),
            leg_stiffness=self._stiffness,
        )

    def _soft_remark(self) -> str:
        """One line on a velocity that the legs are too soft for, or ""."""
        share = self._share()
        if share == 1.0:
            return ""
        return (
            f"velocity clipped to {share:.0%}: legs carry {self._stiffness:.2f} of the table's load,"
            f" gait {self._requested} needs {self._settings.soft[1]:g} for all of it"
        )

    def _ahead(self, times: Array, state: Array) -> tuple[Array, Array]:
        """Velocities (n, 3) and places (n, 3) of the reference at `times` (s) ahead."""
        s, place, gait = self._settings, self._place, self._current.gait
        if (
            place is not None
            and self._path is not None
            and isinstance(gait, Stride)
        ):
            return self._path.ahead(
                place, times, self._speed, gait.reached, self._velocity
            )
        rates = [s.acceleration, s.acceleration, s.turn_acceleration]
        velocity = _toward(
            self._velocity, self._reachable, times[:, None] * rates
        )
        begin = state[[3, 4, 2]] if place is None else place
        return velocity, places_ahead(begin, velocity, s.dt)

    def _is_corrected(self) -> bool:
        """Whether the legs follow the commands and are loaded."""
        gaits = [self._current.gait]
        if self._since_change < self._settings.transition:
            gaits.append(self._previous.gait)
        return (
            self._followed
            and self._followed_for >= SETTLING
            and all(isinstance(gait, Stride) or gait.loaded for gait in gaits)
        )

    def _blend(self, times: Array, velocity: Array) -> Array:
        """Blend (n, 20) of the previous and the present gait at velocities (n, 3)."""
        share = np.clip(
            (self._since_change + times) / max(self._settings.transition, 1e-9),
            0.0,
            1.0,
        )[:, None]
        current = self._table_ahead(self._current, times, velocity)
        if share.min() == 1.0:
            return current
        previous = self._table_ahead(self._previous, times, velocity)
        return (1 - share) * previous + share * current

    def _table_ahead(
        self, active: _Active, times: Array, velocity: Array
    ) -> Array:
        """Angles, normal forces and torso states (n, 20) of a gait at `times` (s) ahead."""
        if isinstance(active.gait, Stride):
            return self._stride_table_ahead(
                active, active.gait, times, velocity
            )
        if active.gait.loaded:
            return self._posture_table_ahead(times)
        slack = np.zeros((len(times), 20))
        slack[:, 13] = self._pose[0]
        return slack

    def _stride_table_ahead(
        self, active: _Active, gait: Stride, times: Array, velocity: Array
    ) -> Array:
        """Table (n, 20) of a stride that moves, stands on its centre, or changes between both."""
        moving = self._moving_after(active, times)[:, None]
        offset, shift = self._at_rest(gait)
        if moving.max() == 0.0:
            return self._posture_table_ahead(times, shift)
        # as in `_stride`
        advances = active is self._current and not self._is_still()
        ahead = times / gait.period if advances else np.zeros_like(times)
        table = gait.stride_table(
            np.mod(active.phase + ahead, 1.0), velocity, offset
        )
        table[:, [13, 8, 9]] += self._pose + np.array(
            [shift - gait.height, 0.0, 0.0]
        )
        if moving.min() == 1.0:
            return table
        still = self._posture_table_ahead(times, shift)
        return (1 - moving) * still + moving * table

    def _at_rest(self, gait: Stride) -> tuple[float, float]:
        """Offsets of the angles (rad) and the height (m) of a stride on legs of this stiffness.

        Legs as the table's need none. A fully pulled soft leg folds, and the robot tips over: the
        walk gives in instead.
        """
        if self._stiffness == 1.0:
            return 0.0, 0.0
        angle, share = np.radians(gait.centre_deg[0]), self._robot.weight / 4
        springs, ratio = self._springs, self._stiffness
        shift = springs.height(share, angle, ratio)
        shift = gait.yields * (shift - springs.height(share, angle))
        loads, height = np.full(2, share), gait.height + np.array([0.0, shift])
        nominal, _ = springs.angle(loads, height)
        _, found = springs.angle(loads, height, ratio)
        return float(found - nominal), shift

    def _posture_table_ahead(self, times: Array, shift: float = 0.0) -> Array:
        """Angles, normal forces and torso states (n, 20) of a posture; linear in the time ahead.

        shift: m, of the height.
        """
        ends = [
            self._posture_row(self._pose_after(t) + np.array([shift, 0.0, 0.0]))
            for t in (0.0, times[-1])
        ]
        share = (times / max(times[-1], 1e-9))[:, None]
        return (1 - share) * ends[0] + share * ends[1]

    def _posture_row(self, pose: Array) -> Array:
        """Angles at which legs at rest carry equal shares of the weight at a pose (3,)."""
        height = self._robot.clamp_heights(*pose)
        share, ratio = np.full(4, self._robot.weight / 4), self._stiffness
        angle = self._springs.angle(share, height, ratio)
        row = np.zeros(20)
        row[:4], row[4:8] = angle, self._springs.at(angle, height, ratio).force
        row[[13, 8, 9]] = pose
        return row


def _toward(value: Array, target: Array, step: Array) -> Array:
    """The value moved toward the target by at most `step`, each element."""
    return value + np.clip(target - value, -step, step)
