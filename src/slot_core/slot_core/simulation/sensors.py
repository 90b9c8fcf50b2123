"""Sensors of the simulated robot: odometry and IMU with white noise and a gyroscope bias."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.dynamics.scene import ImuSettings, OdometrySettings
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.robot import Array


@dataclass(frozen=True)
class OdometryReading:
    """Pose of base_link in odom, twist in base_link, at `stamp` (ns)."""

    stamp: int
    position: Array  # (3,) m
    quaternion: Array  # (4,) x y z w
    velocity: Array  # (3,) m/s
    angular_velocity: Array  # (3,) rad/s


@dataclass(frozen=True)
class ImuReading:
    """Angular velocity and specific force in base_link at `stamp` (ns)."""

    stamp: int
    angular_velocity: Array  # (3,) rad/s
    specific_force: Array  # (3,) m/s^2


def true_odometry(sim: SimulatedRobot, stamp: int) -> OdometryReading:
    """Odometry of the simulated robot at `stamp` (ns), without noise."""
    velocity = sim.rotation.T @ sim.velocity
    return OdometryReading(stamp, sim.position, sim.quaternion, velocity, sim.angular_velocity)


class OdometrySensor:
    """Pose and twist as of a visual SLAM: the truth with independent Gaussian noise."""

    def __init__(self, settings: OdometrySettings, rng: np.random.Generator):
        self._settings, self._rng = settings, rng

    def sample(self, sim: SimulatedRobot, stamp: int) -> OdometryReading:
        """Reading at `stamp` (ns); the noise of the orientation is a rotation vector in odom."""
        truth, noise = true_odometry(sim, stamp), self._rng.normal(size=(4, 3))
        s = self._settings
        turn = Rotation.from_rotvec(s.orientation_noise * noise[1])
        return OdometryReading(
            stamp,
            truth.position + s.position_noise * noise[0],
            (turn * Rotation.from_quat(truth.quaternion)).as_quat(),
            truth.velocity + s.velocity_noise * noise[2],
            truth.angular_velocity + s.rate_noise * noise[3],
        )


class ImuSensor:
    """Gyroscope and accelerometer at the torso's centre; the gyroscope's bias is drawn once."""

    def __init__(self, settings: ImuSettings, rng: np.random.Generator):
        self._settings, self._rng = settings, rng
        self.bias = settings.rate_bias * rng.normal(size=3)

    def sample(self, sim: SimulatedRobot, stamp: int) -> ImuReading:
        """Reading at `stamp` (ns)."""
        rate_noise, force_noise = self._rng.normal(size=(2, 3))
        return ImuReading(
            stamp,
            sim.angular_velocity + self.bias + self._settings.rate_noise * rate_noise,
            sim.specific_force + self._settings.acceleration_noise * force_noise,
        )
