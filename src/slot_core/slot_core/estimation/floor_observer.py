"""Floor observer: where the floor is in odom, and how stiff the legs are for the robot's weight.

A visual SLAM puts the origin of odom where its first image was taken. The floor is where the feet
are. While the torso rests, tendon angles and the leg table tell its pose above the floor
(`legs/leg_table.py`), and so the plane of the floor in odom:

    n = R u_b,    c = (n . p - h) / n_z

with attitude R and place p of the torso in odom, its height h above the floor and the floor's
normal u_b in base_link. The plane goes through (0, 0, c) with the normal n.

    at rest                          learned
    tendons slack                    the floor: the torso lies flat on it, whatever the legs are
    loaded, after that               the ratio kappa, once, from the height
    loaded, never slack before       kappa, if odom's origin can be the floor; else the floor,
                                     with legs as the table's

Later, while it walks too, the floor follows slowly what friction of the feet does not explain.

A floor that differs from z = 0 by less than the method tells is taken for it, and a kappa near 1
for 1. When odom starts anew, height and tilt above the floor go on.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import to_seconds
from slot_core.config import quantity
from slot_core.elementary import atan2, log
from slot_core.estimation.filter_kernels import FilterState
from slot_core.geometry import (
    Transform,
    inverse_quaternion,
    matrix_of_quaternion,
    quaternion_product,
    rpy_of,
    upward,
)
from slot_core.key_frame import StateParts
from slot_core.legs.leg_table import (
    NO_LEAN,
    LegSprings,
    drops,
    read_leg_table,
    rest_pose,
    stiffness_ratio,
)
from slot_core.matrices import norm, product
from slot_core.robot import LEGS, RobotParameters

UP = np.array([0.0, 0.0, 1.0])
FOLLOWED = 3  # ticks between two corrections of the floor
WALKS = 0.01  # m/s, mean speed of a walk
LEANS = 3  # iterations, each of which leaves a twelfth of the error
SOFT = 0.9  # of the table's torque: legs softer than that error
JOINTS_LATE = 0.1  # s, age of tendon angles that are not used


@dataclass(frozen=True)
class FloorObserverSettings:
    """When the torso rests, and what is learned of the floor then."""

    rest_time: float = quantity("time at rest", "s", 0.01, 10)
    rest_speed: float = quantity("largest speed at rest", "m/s", 1e-3, 1)
    rest_rate: float = quantity("largest angular velocity", "rad/s", 1e-3, 10)
    rest_angle: float = quantity(
        "largest change of a tendon angle", "rad", 1e-4, 1
    )
    slack_angle: float = quantity(
        "tendon angle up to which a tendon is slack", "rad", 0.0, 1.0
    )
    offset_min: float = quantity(
        "least height of the floor that is not 0", "m", 0, 0.1
    )
    tilt_min: float = quantity(
        "least tilt of the floor that is not 0", "rad", 0, 0.5
    )
    ratio_change: float = quantity(
        "least change of the stiffness ratio", "", 0, 1
    )
    ratio_min: float = quantity("least stiffness ratio", "", 0.01, 1)
    ratio_max: float = quantity("largest stiffness ratio", "", 1, 100)
    modulus_error: float = quantity(
        "standard deviation of the logarithm of the legs' modulus", "", 0.01, 9
    )
    load_error: float = quantity(
        "standard deviation of the logarithm of the weight", "", 0.01, 9
    )
    torque_error: float = quantity(
        "standard deviation of the logarithm of the torques", "", 0.01, 9
    )
    origin_cost: float = quantity(
        "variances by which an origin elsewhere is less likely", "", 0, 100
    )
    clearance: float = quantity(
        "height of the torso's underside from which it is clear of the floor",
        "m",
        0,
        0.1,
    )
    follow_time: float = quantity(
        "time constant of the mean error, longer than a stride", "s", 0.1, 60
    )
    follow_speed: float = quantity(
        "largest speed of the floor's height", "m/s", 0, 0.1
    )
    follow_rate: float = quantity(
        "largest angular velocity of the floor", "rad/s", 0, 0.1
    )
    lift: float = quantity(
        "height error of a robot that was lifted", "m", 0.001, 1
    )
    height_error: float = quantity(
        "height that friction of the feet explains in a place", "m", 0, 0.1
    )
    walking_error: float = quantity(
        "height that friction of the feet explains in a walk", "m", 0, 0.1
    )
    tilt_error: float = quantity(
        "tilt that friction of the feet explains", "rad", 0, 1
    )
    incline_max: float = quantity(
        "largest angle of the torso to gravity at which it counts as upright",
        "rad",
        0,
        1,
    )
    patience: float = quantity(
        "time without tendon angles, or a rest, after which odom counts as the floor",
        "s",
        0,
        60,
    )


class FloorPlane(NamedTuple):
    """Plane of the floor in odom; its frame has odom's heading and the origin (0, 0, height)."""

    height: float  # m
    normal: Array  # (3,) unit vector, upward

    @property
    def quaternion(self) -> Array:
        """Rotation (4,) x y z w from the floor's frame to odom, about a horizontal axis."""
        x, y, z = self.normal
        turn = np.array([-y, x, 0.0, 1.0 + z])
        return np.asarray(turn / norm(turn))

    @property
    def transform(self) -> Transform:
        """From coordinates in the floor's frame to odom."""
        return Transform(
            matrix_of_quaternion(self.quaternion),
            np.array([0.0, 0.0, self.height]),
        )

    @property
    def is_odom(self) -> bool:
        """Whether the floor is z = 0 of odom."""
        return self.height == 0.0 and bool((self.normal == UP).all())

    def above(self, attitude: Array, position: Array) -> Array:
        """Pose (3,) height m, roll, pitch rad of a torso at a pose in odom."""
        turn = quaternion_product(inverse_quaternion(self.quaternion), attitude)
        roll, pitch, _ = rpy_of(matrix_of_quaternion(turn))
        height = product(self.normal, position) - self.height * self.normal[2]
        return np.array([height, roll, pitch])


LEVEL = FloorPlane(0.0, UP)


class _Rest(NamedTuple):
    """The torso at rest, at a tick."""

    stamp: int  # ns
    joints: Array  # (2, 4) rad, N m
    position: Array  # (3,) m, in odom
    attitude: Array  # (4,) x y z w
    force: Array  # (3,) m/s^2, specific force in base_link

    @property
    def up(self) -> Array:
        """Vertical (3,), in base_link; without an IMU its z axis."""
        size = norm(self.force)
        return self.force / size if size > 0.0 else UP

    def lean(self, tilt: Array) -> Array:
        """Lean (2,) of the vertical above a floor, for the torso's roll and pitch (2,), rad."""
        return (self.up - upward(*tilt))[:2] if self.force.any() else NO_LEAN

    @classmethod
    def mean(cls, rows: Sequence["_Rest"]) -> "_Rest":
        """Mean of some."""
        _, *columns = zip(*rows)
        joints, position, attitude, force = (
            np.sum(column, axis=0) / len(rows) for column in columns
        )
        return cls(
            rows[-1].stamp, joints, position, attitude / norm(attitude), force
        )


class FloorObserver:
    """Learns the floor and the stiffness ratio at rest."""

    STATE = StateParts(
        "floor",
        "ratio",
        "is_known",
        "_lain",
        "_lay",
        "_joints",
        "_stamp",
        "_error",
        "_place",
        "_ticks",
        "_begun",
        "_rest",
        values=(FloorPlane, _Rest),
    )

    def __init__(
        self,
        robot: RobotParameters,
        springs: LegSprings,
        settings: FloorObserverSettings,
        period: float,
    ) -> None:
        """`period`: between ticks, s. Raises ConfigError without a leg table."""
        self._period = period
        self._robot, self._springs, self._settings = robot, springs, settings
        self._tension = read_leg_table(("tension_N",))
        self._lowest = robot.torso.size[2] / 2  # m, height of a torso that lies
        # compiles the kernels
        drops(
            robot, springs, np.zeros(4), rest_pose(robot, springs, np.zeros(4))
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.floor, self.ratio = LEVEL, 1.0
        # whether the floor was seen at rest, or `patience` is over
        self.is_known = False
        # floor below a torso that lay, until it has stood up
        self._lain: FloorPlane | None = None
        self._lay = 0  # ns, when it lay last
        # (2, 4) rad, N m, angles and torques of the tendons
        self._joints = np.full((2, len(LEGS)), np.nan)
        self._stamp = self._begun = 0  # ns, of the angles; of the first tick
        self._rest: deque[_Rest] = deque()
        self._error = np.zeros(3)  # m, rad, mean of the pose above the floor
        self._place = np.zeros(2)  # m, mean of x and y
        self._ticks = 0

    @property
    def legs_are_known(self) -> bool:
        """Whether the ratio is measured, or cannot be, since the torso last lay on the floor."""
        return self.is_known and self._lain is None

    def add_joints(self, stamp: int, angle: Array, torque: Array) -> None:
        """Take tendon angles (4,) rad and torques (4,) N m at `stamp` (ns)."""
        self._stamp = stamp
        self._joints = np.array([angle, torque], dtype=np.float64)

    def observe(
        self, stamp: int, torso: FilterState, rate: Array, force: Array
    ) -> None:
        """Take the torso's motion in odom at a tick.

        rate, force: (3,) angular velocity rad/s and specific force m/s^2 in base_link; without an
        IMU the force is zero.
        """
        s = self._settings
        self._begun = self._begun or stamp
        row = _Rest(stamp, self._joints, torso.position, torso.attitude, force)
        angle = self._joints[0]
        fresh = to_seconds(abs(stamp - self._stamp)) <= JOINTS_LATE and bool(
            np.isfinite(angle).all()
        )
        still = (
            fresh
            and norm(torso.velocity) <= s.rest_speed
            and norm(rate) <= s.rest_rate
        )
        if to_seconds(stamp - self._lay) > s.patience:
            self._lain = None
        self._ticks += 1
        if fresh and self.is_known and self._ticks % FOLLOWED == 0:
            self._follow(row)
        if still and self._rest:
            still = (
                np.abs(self._rest[0].joints[0] - angle).max() <= s.rest_angle
            )
        if not still:
            self._rest.clear()
            if to_seconds(stamp - self._begun) > s.patience:
                self.is_known = True
            return
        self._rest.append(row)
        if to_seconds(stamp - self._rest[0].stamp) >= s.rest_time:
            mean = _Rest.mean(self._rest)
            self._rest.clear()
            if atan2(norm(mean.up[:2]), mean.up[2]) <= s.incline_max:
                self._learn(mean)

    def start_anew(
        self, before: Array, attitude: Array, position: Array
    ) -> None:
        """Odom starts anew at a pose: the pose `before` (3,) above the floor goes on."""
        self._rest.clear()
        self._lain = None
        if self.is_known:
            self.floor = self._near(_floor_below(before, attitude, position))

    def _learn(self, rest: _Rest) -> None:
        """Learn from means at rest."""
        known, self.is_known = self.is_known, True
        angle = rest.joints[0]
        if angle.max() <= self._settings.slack_angle:
            self._lain = _floor_below(
                np.array([self._lowest, 0.0, 0.0]), rest.attitude, rest.position
            )
            self._lay = rest.stamp
            self.floor = self._near(self._lain)
            return
        if self._lain is None:
            seen = self.floor.above(rest.attitude, rest.position)
            held = rest_pose(self._robot, self._springs, angle, self.ratio)
            if not known or abs(seen[0] - held[0]) > self._settings.lift:
                self._locate(rest)
            return
        seen = self._lain.above(rest.attitude, rest.position)
        ratio = stiffness_ratio(self._robot, self._springs, angle, seen)
        self._note(ratio, seen, rest)
        # of a torso that still lies it is an upper bound
        if seen[0] > self._lowest + self._settings.clearance:
            self._lain = None

    def _locate(self, rest: _Rest) -> None:
        """Find the floor below a robot that stands at rest, wherever it was before."""
        self.floor, self.ratio = LEVEL, 1.0
        angle = rest.joints[0]
        seen = self.floor.above(rest.attitude, rest.position)
        ratio = stiffness_ratio(self._robot, self._springs, angle, seen)
        if self._is_at_zero(ratio, seen, rest):
            self._note(ratio, seen, rest)
            return
        self.floor = self._near(
            _floor_below(self._nominal(rest), rest.attitude, rest.position)
        )

    def _nominal(self, rest: _Rest) -> Array:
        """Pose (3,) of nominal legs above the floor below them, at which the vertical leans."""
        pose = np.zeros(3)
        for _ in range(LEANS):
            lean = rest.lean(pose[1:])
            pose = rest_pose(
                self._robot, self._springs, rest.joints[0], lean=lean
            )
        return pose

    def _is_at_zero(self, ratio: float, seen: Array, rest: _Rest) -> bool:
        """Whether z = 0 of odom is likelier the floor than legs and load are the nominal ones.

        If odom's z is vertical, legs that differ explain as much of a tilt as friction does. If it is
        not, the robot stands on a slope or odom is tilted, and the tilt at rest tells these apart.

        With the ratio e of the tendons' torques to the table's at the pose seen, the legs' modulus
        is e and the load e / kappa times the nominal one; with e_1 at the pose of nominal legs the
        torques contradict these. The sums of squared logarithms over their standard deviations are
        compared, with `origin_cost` for an origin elsewhere.
        """
        s, angle = self._settings, rest.joints[0]
        if not np.isfinite(ratio) or seen[0] < self._lowest - s.offset_min:
            return False
        lean = rest.lean(seen[1:])
        held = rest_pose(self._robot, self._springs, angle, ratio, lean)
        is_vertical = norm(lean) < s.tilt_error
        explained = s.tilt_error if is_vertical else s.tilt_min
        if np.abs(seen - held)[1:].max() > explained:
            return False
        modulus = self._torque_ratio(seen, rest)
        if modulus <= 0.0:  # not known
            return s.ratio_min <= ratio <= s.ratio_max
        contradiction = self._torque_ratio(self._nominal(rest), rest)
        return _cost(modulus, s.modulus_error) + _cost(
            modulus / ratio, s.load_error
        ) < s.origin_cost + _cost(contradiction, s.torque_error)

    def _torque_ratio(self, pose: Array, rest: _Rest) -> float:
        """Torques of the tendons over the table's at a pose (3,) above the floor."""
        angle, torque = rest.joints
        drop = drops(self._robot, self._springs, angle, pose)
        tension = self._tension.at(angle, drop)[:, 0].sum()
        expected = tension * self._robot.tendon.spool_radius
        return float(torque.sum() / max(expected, 1e-6))

    def _note(self, ratio: float, seen: Array, rest: _Rest) -> None:
        """Note a ratio at a pose (3,) above the floor; one near 1 is 1.

        Of a torso that still lies it is an upper bound, which helps legs that the torques say are
        soft; servos that hold nominal legs higher under a heavy load would overload.
        """
        s = self._settings
        lies = seen[0] < self._lowest + s.clearance
        if lies and not 0.0 < self._torque_ratio(seen, rest) < SOFT:
            return
        found = min(max(ratio, s.ratio_min), s.ratio_max)
        # on a slope the feet slide while the robot stands up
        told = s.ratio_change + norm(rest.lean(seen[1:]))
        self.ratio = 1.0 if abs(found - 1.0) < told else found

    def _follow(self, now: _Rest) -> None:
        """Move the floor slowly by the mean error that friction of the feet does not explain.

        Over a stride, too, the torso is on average where the legs would hold it at rest.
        """
        s, angle = self._settings, now.joints[0]
        if angle.max() <= s.slack_angle:
            self._error[:] = 0.0
            return
        time = FOLLOWED * self._period
        seen = self.floor.above(now.attitude, now.position)
        error = seen - rest_pose(self._robot, self._springs, angle, self.ratio)
        if abs(error[0]) > s.lift:
            return
        share = time / s.follow_time
        self._error += share * (error - self._error)
        self._place += share * (now.position[:2] - self._place)
        walks = norm(now.position[:2] - self._place) > WALKS * s.follow_time
        height = s.walking_error if walks else s.height_error
        allowed = np.array([height, s.tilt_error, s.tilt_error])
        beyond = self._error - np.clip(self._error, -allowed, allowed)
        if beyond.any():
            most = time * np.array(
                [s.follow_speed, s.follow_rate, s.follow_rate]
            )
            moved = np.clip(beyond, -most, most)
            self._error -= moved
            self.floor = _floor_below(seen - moved, now.attitude, now.position)

    def _near(self, floor: FloorPlane) -> FloorPlane:
        """The floor, or z = 0 of odom if it cannot be told from that."""
        is_near = (
            norm(floor.normal[:2]) < self._settings.tilt_min
            and abs(floor.height) < self._settings.offset_min
        )
        return LEVEL if is_near else floor


def _cost(ratio: float, error: float) -> float:
    """Square of the logarithm of a ratio, over its standard deviation."""
    return float(np.square(log.py_func(ratio) / error))  # type: ignore[attr-defined]


def _floor_below(pose: Array, attitude: Array, position: Array) -> FloorPlane:
    """Floor that a torso is above at a pose (3,) height, roll, pitch, from its pose in odom."""
    normal = product(matrix_of_quaternion(attitude), upward(*pose[1:]))
    return FloorPlane(
        float((product(normal, position) - pose[0]) / normal[2]), normal
    )
