"""Recorded walk as arrays: motion of the torso, tendon angles, times of the control ticks.

Motion and angles are refused unless they are sound: finite values, stamps that increase,
quaternions of length one. Equal messages with one stamp count once. Odometry with a
quaternion of zeros reports that it is lost, and is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.clock import SECOND, time_fault, to_seconds
from slot_core.geometry import matrix_of_quaternion, rotate, rpy_of
from slot_core.robot import LEGS, TENDON_JOINTS
from slot_lab.bags.bag import Bag, BagError, Stamps
from slot_lab.bags.topics import (
    COMMANDED,
    ESTIMATE,
    GROUND_TRUTH,
    IMU,
    LEG_STATES,
    MEASURED,
    ODOMETRY,
    OUTPUTS,
)

STAGES = tuple(OUTPUTS.values())
LENGTH_ERROR = 0.01  # largest deviation of a quaternion's length from one


@dataclass(frozen=True)
class TorsoTrack:
    """The torso's motion over n samples, measured or predicted, in odom."""

    source: str  # topic of a bag, or columns of a CSV file
    t: Array  # (n,) s, graph time
    position: Array  # (n, 3) m
    quaternion: Array  # (n, 4) x y z w, base_link to odom
    velocity: Array  # (n, 3) m/s, in odom
    left_out: int = 0  # readings that report that they are lost

    @cached_property
    def rpy(self) -> Array:
        """(n, 3) roll, pitch and yaw (unwrapped), rad: R = Rz(yaw) Ry(pitch) Rx(roll)."""
        angles = rpy_of(matrix_of_quaternion(self.quaternion))
        angles[:, 2] = np.unwrap(angles[:, 2])
        return angles

    @cached_property
    def pose(self) -> Array:
        """(n, 6) position, m, and roll, pitch, yaw, rad."""
        return np.hstack([self.position, self.rpy])

    def pose_at(self, t: Array) -> Array:
        """Poses (m, 6) at other times (m,), linear in between."""
        return np.column_stack([np.interp(t, self.t, c) for c in self.pose.T])

    @cached_property
    def tilt(self) -> Array:
        """(n,) angle between body z and world z, rad: 2 asin |(q_x, q_y)|."""
        q = self.quaternion / np.linalg.norm(
            self.quaternion, axis=1, keepdims=True
        )
        return 2 * np.arcsin(np.hypot(q[:, 0], q[:, 1]).clip(max=1.0))

    @cached_property
    def heading_velocity(self) -> Array:
        """(n, 2) horizontal velocity along and left of the momentary heading, m/s."""
        return rotate(self.velocity[:, :2], -self.rpy[:, 2])

    def between(self, begin: float, end: float = np.inf) -> TorsoTrack:
        """The samples from graph time `begin` to `end`, s."""
        keep = (self.t >= begin) & (self.t <= end)
        return replace(
            self,
            t=self.t[keep],
            position=self.position[keep],
            quaternion=self.quaternion[keep],
            velocity=self.velocity[keep],
        )


@dataclass(frozen=True)
class TendonAngles:
    """Tendon angles over n samples."""

    source: str  # topic, or columns of a CSV file
    t: Array  # (n,) s, graph time
    angle: Array  # (n, 4) rad
    # (n, 4) rad/s, to extrapolate commands; None: they stay
    rate: Array | None = None
    measured: bool = True  # else they are commands


@dataclass(frozen=True)
class Ticks:
    """Publication times of the messages of each tick; a tick is one state on /mpc_state."""

    stamp: Array  # (n,) s, graph time
    # (n, 5) s, wall clock of the sensor's message and of OUTPUTS; NaN: not published
    time: Array
    period: float  # s, control period: the median distance of the stamps
    end: float  # s, wall clock when the bag ends

    @property
    def latency(self) -> Array:
        """(n, 4) s, between the publications of each stage's input and output.

        NaN where an output precedes its input: nodes in one process publish after the
        command.
        """
        steps = np.diff(self.time, axis=1)
        return np.where((steps < 0).any(axis=1, keepdims=True), np.nan, steps)

    @property
    def end_to_end(self) -> Array:
        """(n,) s, between the publications of the sensor's message and its command."""
        return self.time[:, -1] - self.time[:, 0]

    def after(self, t: float) -> Ticks:
        """The ticks at or after graph time t."""
        keep = self.stamp >= t
        return Ticks(self.stamp[keep], self.time[keep], self.period, self.end)


def stride_mean(t: Array, values: Array, period: float) -> Array:
    """(n,) mean of values (n,) over the stride of `period` (s) centred at each t.

    Difference of the trapezoidal integral between half a period after and half a period
    before; NaN within half a period of either end.
    """
    integral = cumulative_trapezoid(values, t, initial=0)
    before, after = t - period / 2, t + period / 2
    mean = (
        np.interp(after, t, integral) - np.interp(before, t, integral)
    ) / period
    return np.where((before >= t[0]) & (after <= t[-1]), mean, np.nan)


def stride_period(bag: Bag) -> float | None:
    """Median period of the gait while a velocity is commanded, s; None where none is."""
    if not bag.counts.get("/gait_preview"):
        return None
    series = bag.series("/gait_preview", "period", "velocity")
    periods = series["period"][series["velocity"].any(axis=1)]
    return float(np.median(periods)) if len(periods) else None


def seconds(ns: Stamps, origin: int = 0) -> Array:
    """Nanoseconds since `origin` (ns) as seconds."""
    return to_seconds(ns - origin)


def read_motion(bag: Bag, *topics: str) -> TorsoTrack:
    """The motion from the first topic that is recorded (default: truth, else estimate).

    Raises BagError if there is none, for fewer than two samples, and if they are not sound.
    """
    topic = _first_recorded(bag, topics or (GROUND_TRUTH, ESTIMATE))
    where = f"{bag.path}: {topic}"
    if topic == ESTIMATE:
        return _estimated_motion(bag, where)
    fields = (
        "pose.pose.position",
        "pose.pose.orientation",
        "twist.twist.linear",
    )
    series = bag.series(topic, *fields)
    values = np.hstack([series[field] for field in fields])
    known = values[:, 3:7].any(axis=1)
    stamps, values = _sound(where, series.stamp[known], values[known])
    position, quaternion, twist = np.split(values, [3, 7], axis=1)
    length = np.linalg.norm(quaternion, axis=1)
    if (off := np.abs(length - 1.0) > LENGTH_ERROR).any():
        k = int(np.argmax(off))
        raise BagError(
            f"{where}: the quaternion of sample {k} has the length {length[k]:.4g}"
        )
    return TorsoTrack(
        topic,
        seconds(stamps),
        position,
        quaternion,
        velocity=Rotation.from_quat(quaternion).apply(twist),
        left_out=int(np.sum(~known)),
    )


def _estimated_motion(bag: Bag, where: str) -> TorsoTrack:
    """The states of /mpc_state at stamp plus lead, ordered by time.

    Of two states of one time the last is taken: it includes both of two late readings.
    """
    fields = ("position", "rpy", "linear_velocity")
    series = bag.series(ESTIMATE, *fields, "lead")
    lead = series["lead"] @ np.array([SECOND, 1])
    time = series.stamp + lead.astype(np.int64)
    _, last = np.unique(time[::-1], return_index=True)
    newest = len(time) - 1 - last
    values = np.hstack([series[field][newest] for field in fields])
    time, values = _sound(where, time[newest], values)
    position, rpy, velocity = np.split(values, 3, axis=1)
    return TorsoTrack(
        ESTIMATE,
        seconds(time),
        position,
        Rotation.from_euler("xyz", rpy).as_quat(),
        velocity,
    )


def tendon_angles(bag: Bag, *topics: str) -> TendonAngles:
    """Tendon angles of the first topic that is recorded (default: measured, else commanded).

    Raises BagError if there are none, for fewer than two samples, and if they are not
    sound.
    """
    topic = _first_recorded(bag, topics or (MEASURED, COMMANDED))
    measured = topic == MEASURED
    _, values = joint_columns(bag, topic, "position")
    series = bag.series(topic, "velocity")
    if not measured and series["velocity"].size:
        values = np.hstack([values, joint_columns(bag, topic, "velocity")[1]])
    stamps, values = _sound(f"{bag.path}: {topic}", series.stamp, values)
    angle, rate = np.split(values, [len(TENDON_JOINTS)], axis=1)
    return TendonAngles(
        topic, seconds(stamps), angle, rate if rate.size else None, measured
    )


def read_legs(bag: Bag) -> tuple[Array, Array]:
    """Times (n,), s, and recorded shapes (n, 4, m, 3), m, of the legs; raises BagError."""
    series = bag.series(LEG_STATES, "position")
    stamps, flat = _sound(
        f"{bag.path}: {LEG_STATES}",
        series.stamp,
        series["position"].astype(float),
    )
    return seconds(stamps), flat.reshape(len(flat), len(LEGS), -1, 3)


def _sound(where: str, stamps: Stamps, values: Array) -> tuple[Stamps, Array]:
    """Stamps (n,) and values (n, m) without the repetitions of equal samples.

    Raises BagError for a value that is not finite, a stamp before the one before it or far after
    it, two different samples of one stamp, and fewer than two samples.
    """
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        raise BagError(
            f"{where}: message {int(np.argmax(bad))} holds a value that is not finite"
        )
    step = np.diff(stamps)
    if (step < 0).any():
        k = int(np.argmax(step < 0))
        raise BagError(
            f"{where}: time goes back by {to_seconds(-step[k]):g} s after message {k}"
        )
    same = (values[1:] == values[:-1]).all(axis=1)
    if (clash := (step == 0) & ~same).any():
        raise BagError(
            f"{where}: messages {int(np.argmax(clash))} and the next have one stamp"
        )
    keep = (
        np.concatenate([[True], step > 0]) if len(stamps) else np.zeros(0, bool)
    )
    if keep.sum() < 2:
        raise BagError(f"{where}: {keep.sum()} samples, less than 2")
    if fault := time_fault(seconds(stamps)):
        raise BagError(f"{where}: {fault}")
    return stamps[keep], values[keep]


def _first_recorded(bag: Bag, topics: Sequence[str]) -> str:
    """The first topic with messages; raises BagError if there is none."""
    for topic in topics:
        if bag.counts.get(topic):
            return topic
    raise BagError(f"{bag.path}: holds none of {', '.join(topics)}")


def read_ticks(bag: Bag) -> Ticks:
    """The ticks of the chain of nodes; raises BagError for fewer than two states."""
    states = bag.series(ESTIMATE)
    stamps = np.unique(states.stamp)
    if len(stamps) < 2:
        raise BagError(
            f"{bag.path}: {ESTIMATE} holds {len(stamps)} stamps, less than 2"
        )
    origin = int(states.time.min())
    period = float(np.median(np.diff(stamps)))
    times = [_sensor_times(bag, stamps, origin, period)]
    times += [_first_times(bag, topic, stamps, origin) for topic in OUTPUTS]
    return Ticks(
        seconds(stamps),
        np.column_stack(times),
        to_seconds(period),
        end=to_seconds(bag.end_ns - origin),
    )


def _sensor_times(
    bag: Bag, stamps: Stamps, origin: int, period: float
) -> Array:
    """(n,) s since origin (ns) of the message that led to each tick, of stamps (n,); NaN: none.

    It is the IMU's first sample at or after the stamp, within `period` (ns), else the odometry of
    that stamp.
    """
    times = _first_times(bag, ODOMETRY, stamps, origin)
    if bag.counts.get(IMU):
        imu = bag.series(IMU)
        order = np.argsort(imu.stamp)
        at = np.searchsorted(imu.stamp[order], stamps)
        sample = order[np.minimum(at, len(order) - 1)]
        late = imu.stamp[sample] - stamps
        sampled = (late >= 0) & (late < period)
        times[sampled] = seconds(imu.time[sample[sampled]], origin)
    return times


def _first_times(bag: Bag, topic: str, stamps: Stamps, origin: int) -> Array:
    """(n,) s since origin (ns) of the first message with each of the stamps; NaN: none."""
    times = np.full(len(stamps), np.nan)
    if topic in bag.topics:
        series = bag.series(topic)
        _, at, of = np.intersect1d(stamps, series.stamp, return_indices=True)
        times[at] = seconds(series.time[of], origin)
    return times


def joint_columns(bag: Bag, topic: str, quantity: str) -> tuple[Array, Array]:
    """(t (n,) s, values (n, 4)) of a JointState topic in the order of the legs.

    `quantity` is position, velocity or effort. Raises BagError if a message names other
    joints.
    """
    series = bag.series(topic, "name", quantity)
    t, names, values = seconds(series.stamp), series["name"], series[quantity]
    if not len(series):
        return t, np.zeros((0, len(TENDON_JOINTS)))
    wanted = np.sort(TENDON_JOINTS)
    if (
        names.shape[1:] != wanted.shape
        or (np.sort(names, axis=1) != wanted).any()
    ):
        raise BagError(
            f"{bag.path}: {topic} does not name each of {', '.join(TENDON_JOINTS)} once"
        )
    if values.shape != names.shape:
        raise BagError(
            f"{bag.path}: {topic} holds no {quantity} of every joint"
        )
    rank = np.argsort(np.argsort(TENDON_JOINTS))
    place = np.argsort(names, axis=1)[:, rank]
    return t, np.take_along_axis(values, place, axis=1)
