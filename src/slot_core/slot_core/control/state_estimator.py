"""State estimator: odometry and IMU become the twelve states of the MPC, with covariance.

An error-state Kalman filter (Sola, "Quaternion kinematics for the error-state Kalman filter", 2017,
with the angle error in odom): the IMU propagates, the odometry corrects.

    R' = R [w - b_w]x         error  x = [d_theta, d_p, d_v, d_b_w, d_b_f],  R_true = Exp(d_theta) R
    p' = v
    v' = R (f - b_f) + g      w, f: angular velocity and specific force of the IMU, in base_link

An estimate stands at an odometry stamp t and depends on the odometry and IMU stamped up to t only,
not on how the two streams interleave: a reading waits for the IMU to reach its stamp.
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
from slot_core.config import quantity
from slot_core.robot import GRAVITY, Array

SECOND = 1_000_000_000  # ns
DOWN = np.array([0.0, 0.0, -GRAVITY])
COS_PITCH_MIN = (
    1e-3  # roll and yaw are undefined at a pitch of 90 deg; keeps their covariance finite
)
THETA, P, V, GYRO_BIAS, FORCE_BIAS = (slice(i, i + 3) for i in range(0, 15, 3))


class Validity(enum.IntEnum):
    """Why an estimate is or is not usable; the values of slot_msgs/msg/MpcState."""

    VALID = 0
    INITIALISING = 1
    ODOMETRY_REJECTED = 2
    IMU_MISSING = 3


@dataclass(frozen=True)
class OdometrySettings:
    """What the odometry is worth, and what it cannot be."""

    position_noise: float = quantity("standard deviation", "m", 1e-6, 1)
    angle_noise: float = quantity("standard deviation", "rad", 1e-6, 1)
    velocity_noise: float = quantity("standard deviation", "m/s", 1e-6, 10)
    rate_noise: float = quantity("standard deviation of the angular velocity", "rad/s", 1e-6, 10)
    position_max: float = quantity("refused beyond, per axis", "m", 1, 1e6)
    velocity_max: float = quantity("refused beyond, per axis", "m/s", 0.1, 100)
    quaternion_tolerance: float = quantity("largest deviation of its norm from one", "", 1e-9, 0.1)


@dataclass(frozen=True)
class ImuSettings:
    """What the IMU is worth, and what it cannot be."""

    rate: float = quantity("samples per second, nominal", "Hz", 10, 1e4)
    gyro_noise: float = quantity("noise density", "rad/s/sqrt(Hz)", 1e-7, 1)
    acceleration_noise: float = quantity("noise density", "m/s^2/sqrt(Hz)", 1e-7, 10)
    gyro_bias: float = quantity("standard deviation at the start", "rad/s", 0, 1)
    acceleration_bias: float = quantity("the same, tilt of odom included", "m/s^2", 0, 5)
    gyro_drift: float = quantity("random walk of the bias", "rad/s/sqrt(s)", 0, 0.1)
    acceleration_drift: float = quantity("random walk of the bias", "m/s^2/sqrt(s)", 0, 1)
    angular_acceleration_step: float = quantity(
        "change between two samples, by impacts", "rad/s^2", 0, 1e4
    )
    gyro_max: float = quantity("dropped beyond, per axis", "rad/s", 1, 100)
    acceleration_max: float = quantity("dropped beyond, per axis", "m/s^2", 10, 1e4)


@dataclass(frozen=True)
class BlindSettings:
    """How far constant velocities are off where the IMU is missing."""

    gyro_noise: float = quantity("density of the rate's error", "rad/s/sqrt(Hz)", 1e-4, 10)
    acceleration_noise: float = quantity("density of its error", "m/s^2/sqrt(Hz)", 1e-4, 100)


@dataclass(frozen=True)
class GateSettings:
    """When a reading is refused, and when the filter gives in."""

    distance: float = quantity("largest Mahalanobis distance of angle, p, v", "sigma", 3, 1e3)
    max_rejections: int = quantity("in a row, then relocalise if they agree", "", 2, 100)
    agreement_distance: float = quantity("between readings, less their motion", "m", 1e-4, 1)
    agreement_angle: float = quantity("between readings, less their motion", "rad", 1e-4, 1)
    initial_readings: int = quantity("accepted in a row before an estimate is valid", "", 1, 1000)


@dataclass(frozen=True)
class TimingSettings:
    """How long to wait, and what breaks the sequence."""

    imu_wait: float = quantity("newer odometry ends the wait for the IMU", "s", 0, 1)
    imu_gap: float = quantity("longest stretch without a sample", "s", 1e-3, 1)
    odometry_gap: float = quantity("longest time without an accepted reading", "s", 0.02, 5)
    clock_jump: float = quantity("stamps going back further reset the filter", "s", 0.01, 60)


@dataclass(frozen=True)
class BufferSettings:
    """Sizes of the queues."""

    imu: int = quantity("IMU samples", "", 4, 100_000)
    odometry: int = quantity("readings waiting", "", 1, 1000)
    estimates: int = quantity("estimates not yet polled, oldest dropped", "", 1, 10_000)


@dataclass(frozen=True)
class EstimatorSettings:
    """The whole of `config/estimator.yaml`."""

    odometry: OdometrySettings
    imu: ImuSettings
    blind: BlindSettings
    gate: GateSettings
    timing: TimingSettings
    buffers: BufferSettings


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


@dataclass(frozen=True)
class Motion:
    """What a usable odometry reading says: attitude and position in odom, twist in base_link."""

    stamp: int  # ns
    attitude: Rotation
    position: Array
    velocity: Array
    rate: Array


class InertialFilter:
    """The error-state filter: the nominal state, its covariance (15, 15), and the steps on them."""

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._bias = np.zeros((2, 3))  # gyro rad/s, specific force m/s^2
        self._cov = np.zeros((15, 15))
        self._cov[GYRO_BIAS, GYRO_BIAS] = settings.imu.gyro_bias**2 * np.eye(3)
        self._cov[FORCE_BIAS, FORCE_BIAS] = settings.imu.acceleration_bias**2 * np.eye(3)
        odometry = settings.odometry
        noise = [odometry.angle_noise, odometry.position_noise, odometry.velocity_noise]
        self._odometry_cov = np.diag(np.square(np.repeat(noise, 3)))

    def restart(self, motion: Motion) -> None:
        """Take over a reading as it is. The biases stay: they are the sensor's, not the pose's."""
        self._attitude, self._position = motion.attitude, motion.position
        self._velocity = motion.attitude.apply(motion.velocity)
        spread = np.eye(9)
        spread[V, THETA] = -_cross(self._velocity)  # measured in base_link, turned by the attitude
        self._cov[:9, :] = self._cov[:, :9] = 0.0
        self._cov[:9, :9] = spread @ self._odometry_cov @ spread.T
        self._rate, self._rate_variance = motion.rate, self._settings.odometry.rate_noise**2
        self._gyro_share = 0.0

    def use_gyro(self, gyro: Array, amplification: float, late: float) -> None:
        """Take the angular velocity from the gyro (3,), followed on for `late` s since its sample.

        That amplifies the variance of its noise, and misses what an impact has changed since.
        """
        imu = self._settings.imu
        self._rate = gyro - self._bias[0]
        noise = amplification * imu.gyro_noise**2 * imu.rate
        self._rate_variance = noise + (late * imu.angular_acceleration_step) ** 2
        self._gyro_share = 1.0

    def propagate(self, imu: Array, dt: float) -> None:
        """Move on by dt (s) with an IMU sample (6,) [w, f] from the middle of it."""
        rate, force = imu[:3] - self._bias[0], imu[3:] - self._bias[1]
        noise = self._settings.imu
        self._move(rate, force, dt, (noise.gyro_noise, noise.acceleration_noise), 1.0)

    def propagate_blind(self, dt: float) -> None:
        """Move on by dt (s) with constant velocities."""
        blind = self._settings.blind
        middle = Rotation.from_rotvec(-dt / 2 * self._rate) * self._attitude.inv()
        force = middle.apply(-DOWN)
        self._move(self._rate, force, dt, (blind.gyro_noise, blind.acceleration_noise), 0.0)
        self._rate_variance = blind.gyro_noise**2 / dt
        self._gyro_share = 0.0

    def _move(
        self, rate: Array, force: Array, dt: float, noise: tuple[float, float], biased: float
    ) -> None:
        """Midpoint rule for the state, second order in dt for the covariance."""
        half = Rotation.from_rotvec(dt / 2 * rate)
        middle = self._attitude * half
        rotation = middle.as_matrix()
        pull = rotation @ force
        acceleration = pull + DOWN
        self._attitude = middle * half
        self._position = self._position + dt * self._velocity + dt**2 / 2 * acceleration
        self._velocity = self._velocity + dt * acceleration
        flow = np.zeros((15, 15))
        flow[P, V] = np.eye(3)
        flow[V, THETA] = -_cross(pull)
        flow[THETA, GYRO_BIAS] = flow[V, FORCE_BIAS] = -biased * rotation
        self._spread(dt * flow, dt, noise)

    def _spread(self, flow: Array, dt: float, noise: tuple[float, float]) -> None:
        """P <- F (P + Q/2) F^T + Q/2 with F = I + A + A^2 / 2, A = `flow`.

        Half the noise comes before the step, so that the position has its share after a long one.
        """
        imu = self._settings.imu
        density = [noise[0], 0.0, noise[1], imu.gyro_drift, imu.acceleration_drift]
        transition = np.eye(15) + flow + flow @ flow / 2
        half_noise = np.diag(dt / 2 * np.square(np.repeat(density, 3)))
        self._cov = transition @ (self._cov + half_noise) @ transition.T + half_noise

    def correct(self, motion: Motion) -> bool:
        """Correct with a reading at the present stamp; False, and no change, if beyond the gate."""
        jacobian = np.eye(9, 15)
        jacobian[V, THETA] = _cross(self._velocity)
        residual = self._residual(motion)
        spread = jacobian @ self._cov @ jacobian.T + self._odometry_cov
        if not self._inside_gate(residual, spread):
            return False
        gain = np.linalg.solve(spread, jacobian @ self._cov).T
        rest = np.eye(15) - gain @ jacobian
        cov = rest @ self._cov @ rest.T + gain @ self._odometry_cov @ gain.T  # Joseph's form
        self._cov = (cov + cov.T) / 2
        self._shift(gain @ residual)
        self._merge_rate(motion.rate)
        return True

    def _residual(self, motion: Motion) -> Array:
        """(9,) measured less predicted angle, position and velocity, all in odom."""
        angle = (motion.attitude * self._attitude.inv()).as_rotvec()
        velocity = self._attitude.apply(motion.velocity)
        return np.concatenate([angle, motion.position - self._position, velocity - self._velocity])

    def _inside_gate(self, residual: Array, spread: Array) -> bool:
        """Whether the Mahalanobis distances of angle, position and velocity are all small."""
        limit = self._settings.gate.distance**2
        return all(
            residual[block] @ np.linalg.solve(spread[block, block], residual[block]) <= limit
            for block in (THETA, P, V)
        )

    def _shift(self, error: Array) -> None:
        """Move the estimated error (15,) into the nominal state."""
        self._attitude = Rotation.from_rotvec(error[THETA]) * self._attitude
        self._position = self._position + error[P]
        self._velocity = self._velocity + error[V]
        self._bias = self._bias + error[9:].reshape(2, 3)
        self._rate = self._rate - self._gyro_share * error[GYRO_BIAS]

    def _merge_rate(self, rate: Array) -> None:
        """Mean of both angular velocities, weighted by their inverse variances."""
        variance = self._settings.odometry.rate_noise**2
        share = variance / (variance + self._rate_variance)
        self._rate = share * self._rate + (1.0 - share) * rate
        self._rate_variance *= share
        self._gyro_share *= share

    @property
    def gyro_bias(self) -> Array:
        """(3,) rad/s in base_link."""
        return self._bias[0]

    def output(self) -> tuple[Array, Array]:
        """The twelve states of `Estimate` and their covariance, by first-order propagation."""
        rotation = self._attitude.as_matrix()
        rate = rotation @ self._rate
        rpy = _roll_pitch_yaw(rotation)
        jacobian = np.zeros((12, 15))
        jacobian[0:3, THETA] = _rpy_jacobian(rpy)
        jacobian[3:6, P] = jacobian[9:12, V] = np.eye(3)
        jacobian[6:9, THETA] = -_cross(rate)
        jacobian[6:9, GYRO_BIAS] = -self._gyro_share * rotation
        cov = jacobian @ self._cov @ jacobian.T
        cov[6:9, 6:9] += self._rate_variance * np.eye(3)
        return np.concatenate([rpy, self._position, rate, self._velocity]), (cov + cov.T) / 2


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
        self._waiting: deque[tuple[int, Motion | None]] = deque()
        self._rejected: deque[Motion | None] = deque(maxlen=self._settings.gate.max_rejections)
        self._stamp: int | None = None  # of the filter's state; None: it has none
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
    ) -> Motion | None:
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
        return Motion(stamp, Rotation.from_quat(q), p, v, w)

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

    def _is_due(self, stamp: int) -> bool:
        waited = self._waiting[-1][0] - stamp > self._settings.timing.imu_wait * SECOND
        crowded = len(self._waiting) > self._settings.buffers.odometry
        return self._newest.get("imu", stamp - 1) >= stamp or waited or crowded

    def _process(self, stamp: int, motion: Motion | None) -> None:
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

    def _start(self, motion: Motion) -> None:
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
        for begin, end in pairwise(knots):
            imu, _ = _interpolate(samples, (begin + end) // 2)
            self._filter.propagate(imu, (end - begin) / SECOND)
        imu, amplification = _interpolate(samples, stamp)
        self._filter.use_gyro(imu[:3], amplification, (stamp - samples[-1][0]) / SECOND)
        while len(self._imu) > 2 and self._imu[2][0] <= stamp:  # two to extrapolate from
            self._imu.popleft()
        return True

    def _accept(self, stamp: int) -> None:
        self._accepted_stamp = stamp
        self._accepted += 1
        self._rejected.clear()

    def _reject(self, motion: Motion | None) -> None:
        self._rejected.append(motion)
        if self._accepted < self._settings.gate.initial_readings:
            self._accepted = 0

    def _has_relocalised(self) -> bool:
        """Whether `max_rejections` readings in a row were refused and agree among themselves."""
        readings = [motion for motion in self._rejected if motion is not None]
        if len(readings) < self._settings.gate.max_rejections:
            return False
        return all(self._agree(a, b) for a, b in pairwise(readings))

    def _agree(self, a: Motion, b: Motion) -> bool:
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


def _cross(a: Array) -> Array:
    """(3, 3) matrix [a]x with [a]x b = a x b."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _roll_pitch_yaw(rotation: Array) -> Array:
    """(3,) angles with R = Rz(yaw) Ry(pitch) Rx(roll)."""
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    pitch = math.asin(min(max(-rotation[2, 0], -1.0), 1.0))
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    return np.array([roll, pitch, yaw])


def _rpy_jacobian(rpy: Array) -> Array:
    """(3, 3) change of roll, pitch, yaw with a small rotation about the axes of odom."""
    _, pitch, yaw = rpy
    s, c = math.sin(yaw), math.cos(yaw)
    cos_pitch = max(math.cos(pitch), COS_PITCH_MIN)
    t = math.sin(pitch) / cos_pitch
    return np.array([[c / cos_pitch, s / cos_pitch, 0.0], [-s, c, 0.0], [c * t, s * t, 1.0]])
