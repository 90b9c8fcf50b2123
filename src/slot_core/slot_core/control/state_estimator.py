"""State estimator: odometry and IMU become the twelve states of the MPC, with covariance.

An estimate stands at an odometry stamp t and depends on the odometry and IMU stamped up to t only,
not on how the two streams interleave: a reading waits for the IMU to reach its stamp. The filter
itself is in `inertial_filter.py`.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.clock import SECOND
from slot_core.control.inertial_filter import (
    EstimatorSettings,
    InertialFilter,
    OdometryMotion,
    Propagated,
)
from slot_core.robot import Array


class Validity(enum.IntEnum):
    """Why an estimate is or is not usable; the values of slot_msgs/msg/MpcState."""

    VALID = 0
    INITIALISING = 1
    ODOMETRY_REJECTED = 2
    IMU_MISSING = 3


def read_estimator() -> EstimatorSettings:
    """The settings of `config/estimator.yaml`; raises ConfigError."""
    return config.read(EstimatorSettings, "estimator")


@dataclass(frozen=True)
class Estimate:
    """The torso at `stamp` (ns), the stamp of an odometry reading.

    state (12,) is [roll pitch yaw, p, omega, v]: rad, m, rad/s, m/s, all in odom, with
    R = Rz(yaw) Ry(pitch) Rx(roll) and yaw in (-pi, pi]. covariance (12, 12) is in the same order.
    """

    stamp: int
    state: Array
    covariance: Array
    validity: Validity


class StateEstimator:
    """Orders the two streams, filters them, and says how far each estimate can be trusted.

    It is silent until a first usable reading, and again when `odometry_gap` has passed without an
    accepted one and none is usable; else every odometry reading gives one estimate. Sensor data
    never raises: what cannot be used is dropped (IMU) or rejected (odometry).
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._ready: deque[Estimate] = deque(maxlen=settings.buffers.estimates)
        self._reset()

    def _reset(self) -> None:
        self._filter = InertialFilter(self._settings)
        self._newest: dict[str, int] = {}
        self._imu: deque[tuple[int, Array]] = deque(maxlen=self._settings.buffers.imu)
        self._waiting: deque[tuple[int, OdometryMotion | None]] = deque()
        self._rejected: deque[OdometryMotion | None] = deque(
            maxlen=self._settings.gate.max_rejections
        )
        self._stamp: int | None = None  # of the filter's state; None: it has none
        self._ahead: list[tuple[int, Propagated]] = []  # at the samples since `_stamp`
        self._accepted_stamp = 0
        self._accepted = 0  # in a row since the start

    @property
    def gyro_bias(self) -> Array:
        """(3,) rad/s in base_link, as estimated so far."""
        return self._filter.gyro_bias

    def add_imu(self, stamp: int, angular_velocity: Array, specific_force: Array) -> None:
        """Take a sample: stamp (ns), (3,) rad/s and (3,) m/s^2 in base_link."""
        rate = _vector(angular_velocity, 3, self._settings.imu.gyro_max)
        force = _vector(specific_force, 3, self._settings.imu.acceleration_max)
        if rate is None or force is None or not self._advances("imu", stamp):
            return
        self._imu.append((stamp, np.concatenate([rate, force])))
        self._work_off()
        if not self._ready:
            self._look_ahead()

    def add_odometry(
        self,
        stamp: int,
        position: Array,
        quaternion_xyzw: Array,
        velocity: Array,
        angular_velocity: Array,
    ) -> None:
        """Take a reading: stamp (ns), pose in odom (m), twist in base_link (m/s, rad/s)."""
        if not self._advances("odometry", stamp):
            return
        motion = self._decode(stamp, position, quaternion_xyzw, velocity, angular_velocity)
        self._waiting.append((stamp, motion))
        self._work_off()

    def poll(self) -> Estimate | None:
        """The next estimate, in the order of stamps; None if none is ready."""
        return self._ready.popleft() if self._ready else None

    def _decode(
        self, stamp: int, position: Array, quaternion: Array, velocity: Array, rate: Array
    ) -> OdometryMotion | None:
        """The reading, or None if it is not finite, not of the right shape, or out of range."""
        limits = self._settings.odometry
        p = _vector(position, 3, limits.position_max)
        q = _vector(quaternion, 4, 2.0)
        v = _vector(velocity, 3, limits.velocity_max)
        w = _vector(rate, 3, self._settings.imu.gyro_max)
        if p is None or q is None or v is None or w is None:
            return None
        if abs(math.hypot(*q) - 1.0) > limits.quaternion_tolerance:
            return None
        return OdometryMotion(stamp, Rotation.from_quat(q), p, v, w)

    def _advances(self, stream: str, stamp: int) -> bool:
        """Whether `stamp` is the newest of its stream; a clock set back resets the estimator."""
        newest = self._newest.get(stream)
        if newest is not None and newest - stamp > self._settings.timing.clock_jump * SECOND:
            self._reset()
            newest = None
        if newest is not None and stamp <= newest:
            return False
        self._newest[stream] = stamp
        return True

    def _work_off(self) -> None:
        """Process the readings that the IMU has reached, or that have waited long enough."""
        while self._waiting and self._is_due(self._waiting[0][0]):
            self._process(*self._waiting.popleft())
            self._ahead.clear()

    def _is_due(self, stamp: int) -> bool:
        waited = self._waiting[-1][0] - stamp > self._settings.timing.imu_wait * SECOND
        crowded = len(self._waiting) > self._settings.buffers.odometry
        return self._newest.get("imu", stamp - 1) >= stamp or waited or crowded

    def _look_ahead(self) -> None:
        """Propagate to the newest sample: the next reading then finds little left to do."""
        if self._stamp is None:
            return
        now, samples = self._filter.propagated, list(self._imu)
        reached, point = self._ahead[-1] if self._ahead else (self._stamp, now)
        self._filter.go_to(point)
        for stamp, _ in samples:
            if reached < stamp <= self._stamp + self._settings.timing.odometry_gap * SECOND:
                self._step(samples, reached, stamp)
                reached = stamp
                self._ahead.append((stamp, self._filter.propagated))
        self._filter.go_to(now)

    def _step(self, samples: Sequence[tuple[int, Array]], begin: int, end: int) -> None:
        imu, _ = _interpolate(samples, (begin + end) // 2)
        self._filter.propagate(imu, (end - begin) / SECOND)

    def _process(self, stamp: int, motion: OdometryMotion | None) -> None:
        gap = self._settings.timing.odometry_gap * SECOND
        if self._stamp is None or stamp - self._accepted_stamp > gap:
            self._stamp = None
            if motion is not None:
                self._start(motion)
            return
        seen = self._predict(self._stamp, stamp)
        accepted = motion is not None and self._filter.correct(motion)
        if accepted:
            self._accept(stamp)
        else:
            self._reject(motion)
        if motion is not None and self._has_relocalised():
            self._start(motion)
            return
        self._publish(stamp, self._judge(accepted, seen))

    def _start(self, motion: OdometryMotion) -> None:
        self._filter.restart(motion)
        self._stamp, self._accepted = motion.stamp, 0
        self._accept(motion.stamp)
        self._publish(motion.stamp, Validity.INITIALISING)

    def _predict(self, start: int, stamp: int) -> bool:
        """Bring the filter from `start` to `stamp`; False if the IMU was missing on the way."""
        self._stamp = stamp
        samples = [sample for sample in self._imu if sample[0] <= stamp]
        knots = [start, *(t for t, _ in samples if start < t < stamp), stamp]
        before = max((t for t, _ in samples if t <= start), default=start)
        longest = max(b - a for a, b in pairwise([before, *knots[1:]]))
        if not samples or longest > self._settings.timing.imu_gap * SECOND:
            self._filter.propagate_blind((stamp - start) / SECOND)
            return False
        reached = self._go_ahead(samples, start, stamp)
        for begin, end in pairwise([reached, *(t for t in knots if t > reached)]):
            self._step(samples, begin, end)
        imu, amplification = _interpolate(samples, stamp)
        self._filter.use_gyro(imu[:3], amplification, (stamp - samples[-1][0]) / SECOND)
        while len(self._imu) > 2 and self._imu[2][0] <= stamp:  # two to extrapolate from
            self._imu.popleft()
        return True

    def _go_ahead(self, samples: Sequence[tuple[int, Array]], start: int, stamp: int) -> int:
        """Take over what has been done up to `stamp`; return where that ends.

        Without a sample before `start` the first step follows those after it, which may be newer.
        """
        done = [entry for entry in self._ahead if entry[0] <= stamp]
        if not done or samples[0][0] > start:
            return start
        reached, point = done[-1]
        self._filter.go_to(point)
        return reached

    def _accept(self, stamp: int) -> None:
        self._accepted_stamp = stamp
        self._accepted += 1
        self._rejected.clear()

    def _reject(self, motion: OdometryMotion | None) -> None:
        self._rejected.append(motion)
        if self._accepted < self._settings.gate.initial_readings:
            self._accepted = 0

    def _has_relocalised(self) -> bool:
        """Whether `max_rejections` readings in a row were refused and agree among themselves."""
        readings = [motion for motion in self._rejected if motion is not None]
        if len(readings) < self._settings.gate.max_rejections:
            return False
        return all(self._agree(a, b) for a, b in pairwise(readings))

    def _agree(self, a: OdometryMotion, b: OdometryMotion) -> bool:
        """Whether b is where a's and b's mean velocities lead from a."""
        half = (b.stamp - a.stamp) / SECOND / 2
        travel = half * (a.attitude.apply(a.velocity) + b.attitude.apply(b.velocity))
        turn = Rotation.from_rotvec(half * (a.rate + b.rate))
        distance = float(np.linalg.norm(b.position - a.position - travel))
        angle = ((a.attitude * turn).inv() * b.attitude).magnitude()
        gate = self._settings.gate
        return distance <= gate.agreement_distance and bool(angle <= gate.agreement_angle)

    def _judge(self, accepted: bool, seen: bool) -> Validity:
        if not accepted:
            return Validity.ODOMETRY_REJECTED
        if self._accepted < self._settings.gate.initial_readings:
            return Validity.INITIALISING
        return Validity.VALID if seen else Validity.IMU_MISSING

    def _publish(self, stamp: int, validity: Validity) -> None:
        state, covariance = self._filter.output()
        self._ready.append(Estimate(stamp, state, covariance, validity))


def _vector(values: Array, size: int, limit: float) -> Array | None:
    """A copy of `values`, or None unless its shape is (size,) and no element exceeds the limit."""
    array = np.array(values, dtype=np.float64)
    usable = array.shape == (size,) and bool(np.all(np.abs(array) <= limit))  # NaN is not
    return array if usable else None


def _interpolate(samples: Sequence[tuple[int, Array]], stamp: int) -> tuple[Array, float]:
    """The IMU at `stamp` on the line through two neighbouring samples, and its noise variance gain.

    Beyond the last sample the line is followed for one sample interval at most: a held value would
    be late by half an interval, and the torso's angular acceleration makes that the larger error.
    """
    if len(samples) == 1:
        return samples[0][1], 1.0
    after = next((i for i, (t, _) in enumerate(samples) if t >= stamp), len(samples) - 1)
    (t0, x0), (t1, x1) = samples[max(after, 1) - 1], samples[max(after, 1)]
    weight = min(max((stamp - t0) / (t1 - t0), 0.0), 2.0)
    return x0 + weight * (x1 - x0), weight**2 + (1.0 - weight) ** 2
