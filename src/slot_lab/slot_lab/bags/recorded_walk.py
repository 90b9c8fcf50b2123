"""Arrays of a recorded walk: the torso's motion, and the publication times of each control tick."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.clock import to_seconds
from slot_core.geometry import matrix_of_quaternion, rotate, rpy_of
from slot_core.robot import TENDON_JOINTS
from slot_lab.bags.bag import Bag, BagError, Series, Stamps
from slot_lab.bags.topics import ESTIMATE, GROUND_TRUTH

CHAIN = (
    "/odom",
    "/mpc_state",
    "/gait_preview",
    "/tendon_plan",
    "/desired_joint_angles",
)
STAGES = ("state_estimator", "gait_scheduler", "mpc_controller", "force_mapper")


@dataclass(frozen=True)
class TorsoTrack:
    """The torso's motion over n samples of one topic, in odom."""

    source: str  # topic
    t: Array  # (n,) s, graph time
    position: Array  # (n, 3) m
    quaternion: Array  # (n, 4) x y z w, base_link to odom
    velocity: Array  # (n, 3) m/s, in odom
    left_out: int = 0  # readings that say that they are lost

    @cached_property
    def rpy(self) -> Array:
        """(n, 3) roll, pitch and yaw (unwrapped), rad: R = Rz(yaw) Ry(pitch) Rx(roll)."""
        angles = rpy_of(matrix_of_quaternion(self.quaternion))
        angles[:, 2] = np.unwrap(angles[:, 2])
        return angles

    @cached_property
    def tilt(self) -> Array:
        """(n,) angle between body z and world z, rad: 2 asin |(q_x, q_y)|."""
        q = self.quaternion / np.linalg.norm(self.quaternion, axis=1, keepdims=True)
        return 2 * np.arcsin(np.hypot(q[:, 0], q[:, 1]).clip(max=1.0))

    @cached_property
    def heading_velocity(self) -> Array:
        """(n, 2) horizontal velocity along and left of the momentary heading, m/s."""
        return rotate(self.velocity[:, :2], -self.rpy[:, 2])

    def after(self, t: float) -> TorsoTrack:
        """The samples at or after graph time t."""
        keep = self.t >= t
        columns = (self.t, self.position, self.quaternion, self.velocity)
        time, position, quaternion, velocity = (column[keep] for column in columns)
        return TorsoTrack(
            self.source, time, position, quaternion, velocity, self.left_out
        )


@dataclass(frozen=True)
class Ticks:
    """Publication times of the messages of each tick; a tick is one message on /odom."""

    stamp: Array  # (n,) s, graph time
    time: Array  # (n, 5) s, wall clock by topic of CHAIN; NaN: not published
    period: float  # s, control period: the median distance of the stamps
    end: float  # s, wall clock when the bag ends

    @property
    def latency(self) -> Array:
        """(n, 4) s, from the publication of each stage's input to that of its output.

        NaN where an output precedes its input: nodes in one process publish after the command.
        """
        steps = np.diff(self.time, axis=1)
        return np.where((steps < 0).any(axis=1, keepdims=True), np.nan, steps)

    @property
    def end_to_end(self) -> Array:
        """(n,) s, from the publication of the odometry to that of its command."""
        return self.time[:, -1] - self.time[:, 0]

    def after(self, t: float) -> Ticks:
        """The ticks at or after graph time t."""
        keep = self.stamp >= t
        return Ticks(self.stamp[keep], self.time[keep], self.period, self.end)


def stride_mean(t: Array, values: Array, period: float) -> Array:
    """(n,) mean of values (n,) over the stride of `period` (s) centred at each t.

    Difference of the trapezoidal integral between half a period after and half a period before; NaN
    within half a period of either end.
    """
    integral = np.concatenate(
        [[0.0], np.cumsum(np.diff(t) * (values[1:] + values[:-1]) / 2)]
    )
    before, after = t - period / 2, t + period / 2
    mean = (np.interp(after, t, integral) - np.interp(before, t, integral)) / period
    return np.where((before >= t[0]) & (after <= t[-1]), mean, np.nan)


def stride_period(bag: Bag) -> float | None:
    """Median period of the gait while a velocity is commanded, s; None where none ever is."""
    if not bag.counts.get("/gait_preview"):
        return None
    series = bag.series("/gait_preview", "period", "velocity")
    periods = series["period"][series["velocity"].any(axis=1)]
    return float(np.median(periods)) if len(periods) else None


def seconds(ns: Stamps, origin: int = 0) -> Array:
    """Nanoseconds since `origin` (ns) as seconds."""
    return to_seconds(ns - origin)


def read_motion(bag: Bag) -> TorsoTrack:
    """The motion from ground truth if recorded, else from the state estimate.

    Raises BagError if the bag holds neither, or fewer than two samples.
    """
    topic = GROUND_TRUTH if bag.counts.get(GROUND_TRUTH) else ESTIMATE
    if bag.counts.get(topic, 0) < 2:
        held = bag.counts.get(topic, 0)
        raise BagError(f"{bag.path}: {topic} holds {held} messages, less than 2")
    return _true_motion(bag) if topic == GROUND_TRUTH else _estimated_motion(bag)


def _true_motion(bag: Bag) -> TorsoTrack:
    fields = ("pose.pose.position", "pose.pose.orientation", "twist.twist.linear")
    series = bag.series(GROUND_TRUTH, *fields)
    position, quaternion, twist = (series[field] for field in fields)
    velocity = Rotation.from_quat(quaternion).apply(twist)
    return TorsoTrack(
        GROUND_TRUTH, seconds(series.stamp), position, quaternion, velocity
    )


def _estimated_motion(bag: Bag) -> TorsoTrack:
    series = bag.series(ESTIMATE, "position", "rpy", "linear_velocity", "lead")
    time, last = last_states(series)
    time, order = np.unique(
        time, return_index=True
    )  # sorted, also where the clock was set
    new = last[order]
    quaternion = Rotation.from_euler("xyz", series["rpy"][new]).as_quat()
    position, velocity = series["position"][new], series["linear_velocity"][new]
    return TorsoTrack(ESTIMATE, seconds(time), position, quaternion, velocity)


def last_states(series: Series) -> tuple[Stamps, Stamps]:
    """Times (n,), ns, of the states of /mpc_state, stamp plus lead, and indices of their messages.

    Of two states of one time the last is taken: it includes both of two late readings.
    """
    lead = series["lead"] @ np.array([1_000_000_000, 1])
    time = series.stamp + lead.astype(np.int64)
    last = np.flatnonzero(np.append(np.diff(time) != 0, True))
    return time[last], last


def read_ticks(bag: Bag) -> Ticks:
    """The ticks of the chain of nodes; raises BagError if /odom holds fewer than two stamps."""
    odom = bag.series(CHAIN[0])
    stamps = np.unique(odom.stamp)
    if len(stamps) < 2:
        raise BagError(f"{bag.path}: /odom holds {len(stamps)} stamps, less than 2")
    origin = int(odom.time.min())
    times = [_first_times(bag, topic, stamps, origin) for topic in CHAIN]
    period = to_seconds(float(np.median(np.diff(stamps))))
    end = to_seconds(bag.end_ns - origin)
    return Ticks(seconds(stamps), np.column_stack(times), period, end)


def _first_times(bag: Bag, topic: str, stamps: Stamps, origin: int) -> Array:
    """(n,) s since origin (ns) of the first message with each of the sorted stamps; NaN: none."""
    times = np.full(len(stamps), np.nan)
    if topic not in bag.topics:
        return times
    series = bag.series(topic)
    known, first = np.unique(series.stamp, return_index=True)
    _, at, of = np.intersect1d(stamps, known, assume_unique=True, return_indices=True)
    times[at] = seconds(series.time[first[of]], origin)
    return times


def joint_columns(bag: Bag, topic: str, quantity: str) -> tuple[Array, Array]:
    """(t (n,) s, values (n, 4)) of a JointState topic in the order of the legs.

    `quantity` is position, velocity or effort. Raises BagError if a message names other joints.
    """
    series = bag.series(topic, "name", quantity)
    t, names, values = seconds(series.stamp), series["name"], series[quantity]
    if not len(series):
        return t, np.zeros((0, len(TENDON_JOINTS)))
    count = (len(TENDON_JOINTS),)
    if names.shape[1:] != count or np.any(
        np.sort(names, axis=1) != np.sort(TENDON_JOINTS)
    ):
        raise BagError(
            f"{bag.path}: {topic} does not name each of {', '.join(TENDON_JOINTS)} once"
        )
    if values.shape != names.shape:
        raise BagError(f"{bag.path}: {topic} holds no {quantity} of every joint")
    order = np.array(
        [[list(row).index(joint) for joint in TENDON_JOINTS] for row in names]
    )
    return t, np.take_along_axis(values, order, axis=1)
