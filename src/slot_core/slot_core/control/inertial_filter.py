"""Error-state Kalman filter of the torso: the IMU propagates, the odometry corrects.

After Sola, "Quaternion kinematics for the error-state Kalman filter", 2017, with the angle error in
odom:

    R' = R [w - b_w]x
    p' = v
    v' = R (f - b_f) + g

with w, f the angular velocity and specific force of the IMU in base_link and b_w, b_f their biases.
The error state is x = [d_theta, d_p, d_v, d_b_w, d_b_f] (15,), with R_true = Exp(d_theta) R.
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
COS_PITCH_MIN = 1e-3  # keeps the covariance of roll and yaw finite at a pitch of 90 deg
THETA, P, V, GYRO_BIAS, FORCE_BIAS = (slice(i, i + 3) for i in range(0, 15, 3))


@dataclass(frozen=True)
class OdometryNoise:
    """Noise and admissible range of the odometry."""

    position_noise: float = quantity("standard deviation of the position", "m", 1e-6, 1)
    angle_noise: float = quantity("standard deviation of the attitude", "rad", 1e-6, 1)
    velocity_noise: float = quantity("standard deviation of the velocity", "m/s", 1e-6, 10)
    rate_noise: float = quantity("standard deviation of the angular velocity", "rad/s", 1e-6, 10)
    position_max: float = quantity("largest magnitude accepted, per axis", "m", 1, 1e6)
    velocity_max: float = quantity("largest magnitude accepted, per axis", "m/s", 0.1, 100)
    quaternion_tolerance: float = quantity("largest error of its norm", "", 1e-9, 0.1)


@dataclass(frozen=True)
class ImuNoise:
    """Noise, biases and admissible range of the IMU."""

    rate: float = quantity("nominal sample rate", "Hz", 10, 1e4)
    gyro_noise: float = quantity("noise density", "rad/s/sqrt(Hz)", 1e-7, 1)
    acceleration_noise: float = quantity("noise density", "m/s^2/sqrt(Hz)", 1e-7, 10)
    gyro_bias: float = quantity("initial standard deviation", "rad/s", 0, 1)
    acceleration_bias: float = quantity("the same, with the tilt of odom", "m/s^2", 0, 5)
    gyro_drift: float = quantity("random walk of the bias", "rad/s/sqrt(s)", 0, 0.1)
    acceleration_drift: float = quantity("random walk of the bias", "m/s^2/sqrt(s)", 0, 1)
    angular_acceleration_step: float = quantity(
        "change between two samples, by impacts", "rad/s^2", 0, 1e4
    )
    gyro_max: float = quantity("largest magnitude accepted, per axis", "rad/s", 1, 100)
    acceleration_max: float = quantity("largest magnitude accepted, per axis", "m/s^2", 10, 1e4)


@dataclass(frozen=True)
class BlindSettings:
    """Process noise of the constant-velocity model, used without IMU data."""

    gyro_noise: float = quantity(
        "noise density of the angular velocity", "rad/s/sqrt(Hz)", 1e-4, 10
    )
    acceleration_noise: float = quantity(
        "noise density of the acceleration", "m/s^2/sqrt(Hz)", 1e-4, 100
    )


@dataclass(frozen=True)
class OutlierSettings:
    """Outlier gate of the odometry, and when the filter restarts from rejected readings."""

    distance: float = quantity("largest Mahalanobis distance of angle, p, v", "sigma", 3, 1e3)
    max_rejections: int = quantity("in a row; then restart if they agree", "", 2, 100)
    agreement_distance: float = quantity("between readings, motion subtracted", "m", 1e-4, 1)
    agreement_angle: float = quantity("between readings, motion subtracted", "rad", 1e-4, 1)
    initial_readings: int = quantity("accepted in a row until valid", "", 1, 1000)


@dataclass(frozen=True)
class TimingSettings:
    """Waiting time for the IMU, and gaps after which the filter degrades or restarts."""

    imu_wait: float = quantity("odometry newer by this ends the wait for the IMU", "s", 0, 1)
    imu_gap: float = quantity("longest interval between samples", "s", 1e-3, 1)
    odometry_gap: float = quantity("longest interval between accepted readings", "s", 0.02, 5)
    clock_jump: float = quantity(
        "a larger step back of the stamps resets the filter", "s", 0.01, 60
    )


@dataclass(frozen=True)
class BufferSettings:
    """Lengths of the queues."""

    imu: int = quantity("IMU samples", "", 4, 100_000)
    odometry: int = quantity("readings waiting", "", 1, 1000)
    estimates: int = quantity("estimates not yet polled; the oldest is dropped", "", 1, 10_000)


@dataclass(frozen=True)
class EstimatorSettings:
    """Settings of `config/estimator.yaml`."""

    odometry: OdometryNoise
    imu: ImuNoise
    blind: BlindSettings
    gate: OutlierSettings
    timing: TimingSettings
    buffers: BufferSettings


@dataclass(frozen=True)
class OdometryMotion:
    """A decoded odometry reading: attitude and position in odom, twist in base_link."""

    stamp: int  # ns
    attitude: Rotation
    position: Array  # (3,) m
    velocity: Array  # (3,) m/s
    rate: Array  # (3,) rad/s


class Propagated(NamedTuple):
    """The part of the filter that `InertialFilter.propagate` changes: nominal state, covariance."""

    attitude: Rotation
    position: Array  # (3,) m, in odom
    velocity: Array  # (3,) m/s, in odom
    cov: Array  # (15, 15)


class InertialFilter:
    """Error-state filter: nominal state, covariance (15, 15), propagation and correction."""

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
        """Set the state to an odometry reading; the biases and their covariance are kept."""
        self._attitude, self._position = motion.attitude, motion.position
        self._velocity = motion.attitude.apply(motion.velocity)
        jacobian = np.eye(9)
        jacobian[V, THETA] = -_cross(self._velocity)  # velocity is measured in base_link
        self._cov[:9, :] = self._cov[:, :9] = 0.0
        self._cov[:9, :9] = jacobian @ self._odometry_cov @ jacobian.T
        self._rate, self._rate_variance = motion.rate, self._settings.odometry.rate_noise**2
        self._gyro_share = 0.0

    @property
    def propagated(self) -> Propagated:
        """Present propagated state, for `restore`."""
        return Propagated(self._attitude, self._position, self._velocity, self._cov)

    def restore(self, saved: Propagated) -> None:
        """Set the propagated state to a saved one; valid only without a correction in between."""
        self._attitude, self._position, self._velocity, self._cov = saved

    def use_gyro(self, gyro: Array, amplification: float, age: float) -> None:
        """Set the angular velocity from the gyro (3,) rad/s, extrapolated over `age` (s).

        amplification: factor of the noise variance by the extrapolation. The variance includes the
        change by an impact since the last sample.
        """
        imu = self._settings.imu
        self._rate = gyro - self._bias[0]
        noise = amplification * imu.gyro_noise**2 * imu.rate
        self._rate_variance = noise + (age * imu.angular_acceleration_step) ** 2
        self._gyro_share = 1.0

    def propagate(self, imu: Array, dt: float) -> None:
        """Propagate by dt (s) with the IMU sample (6,) [w, f] (rad/s, m/s^2) at its midpoint."""
        rate, force = imu[:3] - self._bias[0], imu[3:] - self._bias[1]
        noise = self._settings.imu
        self._integrate(rate, force, dt, (noise.gyro_noise, noise.acceleration_noise), 1.0)

    def propagate_blind(self, dt: float) -> None:
        """Propagate by dt (s) at constant velocities, without IMU data."""
        blind = self._settings.blind
        middle = Rotation.from_rotvec(-dt / 2 * self._rate) * self._attitude.inv()
        force = middle.apply(-DOWN)
        self._integrate(self._rate, force, dt, (blind.gyro_noise, blind.acceleration_noise), 0.0)
        self._rate_variance = blind.gyro_noise**2 / dt
        self._gyro_share = 0.0

    def _integrate(
        self, rate: Array, force: Array, dt: float, noise: tuple[float, float], biased: float
    ) -> None:
        """Integrate by the midpoint rule; the covariance is second order in dt.

        rate (3,) rad/s and force (3,) m/s^2 in base_link; noise: their densities; biased: 1 if
        they come from the IMU, so that its biases act, else 0.
        """
        half = Rotation.from_rotvec(dt / 2 * rate)
        middle = self._attitude * half
        rotation = middle.as_matrix()
        force_odom = rotation @ force
        acceleration = force_odom + DOWN
        self._attitude = middle * half
        self._position = self._position + dt * self._velocity + dt**2 / 2 * acceleration
        self._velocity = self._velocity + dt * acceleration
        dynamics = np.zeros((15, 15))
        dynamics[P, V] = np.eye(3)
        dynamics[V, THETA] = -_cross(force_odom)
        dynamics[THETA, GYRO_BIAS] = dynamics[V, FORCE_BIAS] = -biased * rotation
        self._propagate_covariance(dt * dynamics, dt, noise)

    def _propagate_covariance(self, a: Array, dt: float, noise: tuple[float, float]) -> None:
        """P <- F (P + Q/2) F^T + Q/2 with F = I + A + A^2 / 2 and A (15, 15) = dt dx'/dx.

        Half of the noise Q enters before the step, so that it reaches the position in a long step.
        """
        imu = self._settings.imu
        density = [noise[0], 0.0, noise[1], imu.gyro_drift, imu.acceleration_drift]
        transition = np.eye(15) + a + a @ a / 2
        half_noise = np.diag(dt / 2 * np.square(np.repeat(density, 3)))
        self._cov = transition @ (self._cov + half_noise) @ transition.T + half_noise

    def correct(self, motion: OdometryMotion) -> bool:
        """Correct with a reading at the present stamp; False for an outlier, which is ignored."""
        jacobian = np.eye(9, 15)
        jacobian[V, THETA] = _cross(self._velocity)
        residual = self._residual(motion)
        innovation_cov = jacobian @ self._cov @ jacobian.T + self._odometry_cov
        if not self._inside_gate(residual, innovation_cov):
            return False
        gain = np.linalg.solve(innovation_cov, jacobian @ self._cov).T
        reduction = np.eye(15) - gain @ jacobian
        # Joseph's form
        cov = reduction @ self._cov @ reduction.T + gain @ self._odometry_cov @ gain.T
        self._cov = (cov + cov.T) / 2
        self._inject_error(gain @ residual)
        self._merge_rate(motion.rate)
        return True

    def _residual(self, motion: OdometryMotion) -> Array:
        """Innovation (9,): measured minus predicted angle, position and velocity, all in odom."""
        angle = (motion.attitude * self._attitude.inv()).as_rotvec()
        velocity = self._attitude.apply(motion.velocity)
        return np.concatenate([angle, motion.position - self._position, velocity - self._velocity])

    def _inside_gate(self, residual: Array, cov: Array) -> bool:
        """Whether angle, position and velocity are each within the gate's Mahalanobis distance."""
        limit = self._settings.gate.distance**2
        return all(
            residual[block] @ np.linalg.solve(cov[block, block], residual[block]) <= limit
            for block in (THETA, P, V)
        )

    def _inject_error(self, error: Array) -> None:
        """Add the estimated error (15,) to the nominal state and the biases."""
        self._attitude = Rotation.from_rotvec(error[THETA]) * self._attitude
        self._position = self._position + error[P]
        self._velocity = self._velocity + error[V]
        self._bias = self._bias + error[9:].reshape(2, 3)
        self._rate = self._rate - self._gyro_share * error[GYRO_BIAS]

    def _merge_rate(self, rate: Array) -> None:
        """Fuse the odometry's angular velocity (3,) rad/s, weighted by the inverse variances."""
        variance = self._settings.odometry.rate_noise**2
        share = variance / (variance + self._rate_variance)
        self._rate = share * self._rate + (1.0 - share) * rate
        self._rate_variance *= share
        self._gyro_share *= share

    @property
    def gyro_bias(self) -> Array:
        """Estimated gyro bias (3,) rad/s, in base_link."""
        return self._bias[0]

    def output(self) -> tuple[Array, Array]:
        """State (12,) and covariance (12, 12) of `Estimate`; the covariance is of first order."""
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
    """Cross product matrix [a]x (3, 3): [a]x b = a x b."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _roll_pitch_yaw(rotation: Array) -> Array:
    """Angles (3,) rad with R = Rz(yaw) Ry(pitch) Rx(roll)."""
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    pitch = math.asin(min(max(-rotation[2, 0], -1.0), 1.0))
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    return np.array([roll, pitch, yaw])


def _rpy_jacobian(rpy: Array) -> Array:
    """Derivative (3, 3) of roll, pitch, yaw by a small rotation about the axes of odom."""
    _, pitch, yaw = rpy
    s, c = math.sin(yaw), math.cos(yaw)
    cos_pitch = max(math.cos(pitch), COS_PITCH_MIN)
    t = math.sin(pitch) / cos_pitch
    return np.array([[c / cos_pitch, s / cos_pitch, 0.0], [-s, c, 0.0], [c * t, s * t, 1.0]])
