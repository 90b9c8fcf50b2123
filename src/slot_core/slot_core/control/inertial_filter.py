"""An inertial filter: the IMU propagates the torso's state, the odometry corrects it.

An error-state Kalman filter (Sola, "Quaternion kinematics for the error-state Kalman filter", 2017,
with the angle error in odom).

    R' = R [w - b_w]x         error  x = [d_theta, d_p, d_v, d_b_w, d_b_f],  R_true = Exp(d_theta) R
    p' = v
    v' = R (f - b_f) + g      w, f: angular velocity and specific force of the IMU, in base_link
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.config import quantity
from slot_core.robot import GRAVITY, Array

DOWN = np.array([0.0, 0.0, -GRAVITY])
COS_PITCH_MIN = 1e-3  # roll and yaw are undefined at 90 deg; keeps their covariance finite
THETA, P, V, GYRO_BIAS, FORCE_BIAS = (slice(i, i + 3) for i in range(0, 15, 3))


@dataclass(frozen=True)
class OdometryNoise:
    """What the odometry is worth, and what it cannot be."""

    position_noise: float = quantity("standard deviation", "m", 1e-6, 1)
    angle_noise: float = quantity("standard deviation", "rad", 1e-6, 1)
    velocity_noise: float = quantity("standard deviation", "m/s", 1e-6, 10)
    rate_noise: float = quantity("standard deviation of the angular velocity", "rad/s", 1e-6, 10)
    position_max: float = quantity("refused beyond, per axis", "m", 1, 1e6)
    velocity_max: float = quantity("refused beyond, per axis", "m/s", 0.1, 100)
    quaternion_tolerance: float = quantity("largest deviation of its norm from one", "", 1e-9, 0.1)


@dataclass(frozen=True)
class ImuNoise:
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
class OutlierSettings:
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

    odometry: OdometryNoise
    imu: ImuNoise
    blind: BlindSettings
    gate: OutlierSettings
    timing: TimingSettings
    buffers: BufferSettings


@dataclass(frozen=True)
class OdometryMotion:
    """What a usable odometry reading says: attitude and position in odom, twist in base_link."""

    stamp: int  # ns
    attitude: Rotation
    position: Array
    velocity: Array
    rate: Array


class Propagated(NamedTuple):
    """What `InertialFilter.propagate` changes."""

    attitude: Rotation
    position: Array
    velocity: Array
    cov: Array  # (15, 15)


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

    def restart(self, motion: OdometryMotion) -> None:
        """Take over a reading as it is. The biases stay: they are the sensor's, not the pose's."""
        self._attitude, self._position = motion.attitude, motion.position
        self._velocity = motion.attitude.apply(motion.velocity)
        spread = np.eye(9)
        spread[V, THETA] = -_cross(self._velocity)  # measured in base_link, turned by the attitude
        self._cov[:9, :] = self._cov[:, :9] = 0.0
        self._cov[:9, :9] = spread @ self._odometry_cov @ spread.T
        self._rate, self._rate_variance = motion.rate, self._settings.odometry.rate_noise**2
        self._gyro_share = 0.0

    @property
    def propagated(self) -> Propagated:
        """Where propagation has led; to be given back with `go_to`."""
        return Propagated(self._attitude, self._position, self._velocity, self._cov)

    def go_to(self, point: Propagated) -> None:
        """Be where propagation has led before; nothing may have been corrected in between."""
        self._attitude, self._position, self._velocity, self._cov = point

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

    def correct(self, motion: OdometryMotion) -> bool:
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

    def _residual(self, motion: OdometryMotion) -> Array:
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
