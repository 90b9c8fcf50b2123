"""Sensors of the simulated robot: odometry that drifts, jumps and is lost; IMU with a bias."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from slot_core.arrays import Array
from slot_core.compiled import kernel
from slot_core.dynamics.scene import (
    CameraSettings,
    ImuSettings,
    OdometrySettings,
)
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.elementary import cos, log
from slot_core.geometry import quaternion_of_vector, quaternion_product, rotate
from slot_core.matrices import product
from slot_core.simulation.readings import (
    ImuReading,
    OdometryReading,
    lost_odometry,
)

if TYPE_CHECKING:
    from slot_core.simulation.camera_sensor import CameraSensor


@kernel
def _add_noise(reading, uniform, deviation, largest):  # type: ignore[no-untyped-def]
    """Add normal noise to a reading (n,), of standard deviations (n,); it ends at +-largest (n,).

    uniform: (2 n,) uniformly distributed numbers (Box, Muller).
    """
    for i in range(reading.size):
        turn = 2.0 * np.pi * uniform[reading.size + i]
        noise = math.sqrt(-2.0 * log(1.0 - uniform[i])) * cos(turn)
        value = reading[i] + deviation[i] * noise
        reading[i] = (
            math.copysign(largest[i], value)
            if abs(value) > largest[i]
            else value
        )


def normal(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Numbers of the standard normal distribution, the same on every processor."""
    n = math.prod(shape)
    drawn = -np.zeros(n)  # -0 + x is x, also for x = -0
    _add_noise(drawn, rng.random(2 * n), np.ones(n), np.full(n, math.inf))
    return drawn.reshape(shape)


def true_odometry(sim: SimulatedRobot, stamp: int) -> OdometryReading:
    """Odometry of the simulated robot at `stamp` (ns), without noise."""
    return OdometryReading(
        stamp,
        sim.position,
        sim.quaternion,
        product(sim.rotation.T, sim.velocity),
        sim.angular_velocity,
    )


class OdometrySensor:
    """Pose and twist as of a visual SLAM: the truth with independent Gaussian noise.

    From the start on it also drifts, jumps, and is lost, as the settings say.
    """

    def __init__(
        self,
        settings: OdometrySettings,
        rng: np.random.Generator,
        trouble: np.random.Generator,
    ):
        """`rng` draws the noise, `trouble` drift, losses and delays."""
        self._settings, self._rng, self._trouble = settings, rng, trouble
        self._drift = np.zeros(4)  # m, rad: displacement and yaw
        self._last = 0.0  # s since the start
        rotate(self._drift[:2], 0.0)  # compiles its kernel

    def sample(
        self, truth: OdometryReading, since: float = 0.0
    ) -> OdometryReading:
        """Noisy odometry from the true one, `since` the start (s; 0: before it).

        The noise of the orientation is a rotation vector in odom.
        """
        s, noise = self._settings, normal(self._rng, (4, 3))
        displacement = self._displacement(since)
        within = any(
            d.time <= since < d.time + d.duration for d in s.dropouts.values()
        )
        if since > 0.0 and (self._trouble.random() < s.loss or within):
            return lost_odometry(truth.stamp)
        position = truth.position + s.position_noise * noise[0]
        attitude = quaternion_product(
            quaternion_of_vector(s.orientation_noise * noise[1]),
            truth.quaternion,
        )
        if displacement.any():
            position[:2] = rotate(position[:2], displacement[3])
            position += displacement[:3]
            attitude = quaternion_product(
                quaternion_of_vector(np.array([0.0, 0.0, displacement[3]])),
                attitude,
            )
        return OdometryReading(
            truth.stamp,
            position,
            attitude,
            truth.velocity + s.velocity_noise * noise[2],
            truth.angular_velocity + s.rate_noise * noise[3],
        )

    def delay(self) -> float:
        """Delay of the next reading, s."""
        return max(
            0.0,
            self._settings.delay
            + self._settings.jitter * self._trouble.uniform(-1.0, 1.0),
        )

    def _displacement(self, since: float) -> Array:
        """Displacement (3,), m, and yaw, rad, of the odometry by its drift and jumps so far."""
        s = self._settings
        scale = np.array([s.position_drift] * 3 + [s.yaw_drift]) * np.sqrt(
            since - self._last
        )
        self._drift += scale * normal(self._trouble, (4,))
        self._last = since
        jumps = [
            [*j.position, j.yaw]
            for j in s.jumps.values()
            if since > 0.0 and j.time <= since
        ]
        return self._drift + np.sum(jumps, axis=0) if jumps else self._drift


# rad/s, 2000 deg/s; m/s^2, 16 g
IMU_RANGE = np.repeat([34.9, 156.9], 3)


class ImuSensor:
    """Gyroscope and accelerometer at the torso's centre; the gyroscope's bias is drawn once.

    Both saturate: a sample comes at every period, also of a robot that falls.
    """

    def __init__(self, settings: ImuSettings, rng: np.random.Generator):
        self._rng = rng
        self.bias = settings.rate_bias * normal(rng, (3,))
        # rad/s, m/s^2: standard deviations
        self._noise = np.repeat(
            [settings.rate_noise, settings.acceleration_noise], 3
        )

    def sample(self, sim: SimulatedRobot, stamp: int) -> ImuReading:
        """Reading at `stamp` (ns)."""
        reading = np.concatenate(
            [sim.angular_velocity + self.bias, sim.specific_force]
        )
        _add_noise(reading, self._rng.random(12), self._noise, IMU_RANGE)
        return ImuReading(stamp, reading[:3], reading[3:])


def make_camera(
    settings: CameraSettings, rng: np.random.Generator
) -> CameraSensor | None:
    """The camera of a scene, if it has one; OpenCV is loaded only then."""
    if not settings.enabled:
        return None
    from slot_core.simulation.camera_sensor import CameraSensor  # noqa: PLC0415

    return CameraSensor(settings, rng)
