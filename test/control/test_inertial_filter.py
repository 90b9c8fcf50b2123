"""Compiled filter against a plain one on scipy's rotations; the biases that it learns."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core.clock import SECOND
from slot_core.estimation.imu_samples import ImuSamples
from slot_core.estimation.inertial_filter import InertialFilter, OdometryMotion
from slot_core.estimation.state_estimator import read_estimator
from slot_core.robot import GRAVITY

SETTINGS = read_estimator()
DOWN = np.array([0.0, 0.0, -GRAVITY])
DT = 0.005  # s
NOISE = SETTINGS.odometry
DEVIATION = [
    NOISE.angle_noise,
    NOISE.position_noise,
    NOISE.velocity_noise,
    NOISE.rate_noise,
]
VARIANCE = np.repeat(DEVIATION, 3) ** 2
# a visual SLAM may know one direction better than another
VARIANCE[6:9] *= [0.25, 1.0, 4.0]


def cross(a):
    """[a]x by its columns a x e_i."""
    return np.column_stack([np.cross(a, axis) for axis in np.eye(3)])


class PlainFilter:
    """The equations of `inertial_filter.py`, dense, corrected in information form."""

    def __init__(self, motion):
        imu, odometry = SETTINGS.imu, SETTINGS.odometry
        self.attitude = Rotation.from_quat(motion.attitude)
        self.p, self.v = motion.position, self.attitude.apply(motion.velocity)
        self.bias, self.rate = np.zeros(6), motion.rate
        biases = np.repeat([imu.gyro_bias, imu.acceleration_bias], 3) ** 2
        self.cov = np.zeros((15, 15))
        h = np.linalg.inv(self.measurement()[:, :9])
        self.cov[:9, :9], self.cov[9:, 9:] = (
            h @ self.noise() @ h.T,
            np.diag(biases),
        )
        self.variance, self.share = odometry.rate_noise**2, 0.0

    def noise(self):
        """Covariance (9, 9) of a reading, in odom; that of the velocity is given in base_link."""
        noise = np.diag(VARIANCE[:9])
        turn = self.attitude.as_matrix()
        noise[6:, 6:] = turn @ noise[6:, 6:] @ turn.T
        return noise

    def measurement(self):
        h = np.eye(9, 15)
        h[6:9, 0:3] = cross(self.v)
        return h

    def propagate(self, sample):
        imu, zero, eye = SETTINGS.imu, np.zeros((3, 3)), np.eye(3)
        w, f = (sample - self.bias).reshape(2, 3)
        middle = self.attitude * Rotation.from_rotvec(w * DT / 2)
        r, force = middle.as_matrix(), middle.apply(f)
        self.attitude = middle * Rotation.from_rotvec(w * DT / 2)
        self.p = self.p + DT * self.v + DT**2 / 2 * (force + DOWN)
        self.v = self.v + DT * (force + DOWN)
        a = DT * np.block(
            [
                [zero, zero, zero, -r, zero],
                [zero, zero, eye, zero, zero],
                [-cross(force), zero, zero, zero, -r],
                [np.zeros((6, 15))],
            ]
        )
        density = [imu.gyro_noise, 0, imu.acceleration_noise, imu.gyro_drift]
        q = (
            DT
            / 2
            * np.diag(np.repeat([*density, imu.acceleration_drift], 3) ** 2)
        )
        f = np.eye(15) + a + a @ a / 2
        self.cov = f @ (self.cov + q) @ f.T + q

    def use_gyro(self, gyro):
        self.rate, self.share = gyro - self.bias[:3], 1.0
        self.variance = SETTINGS.imu.gyro_noise**2 * SETTINGS.imu.rate

    def correct(self, motion):
        h, weight = self.measurement(), np.linalg.inv(self.noise())
        seen = Rotation.from_quat(motion.attitude)
        turn = (seen * self.attitude.inv()).as_rotvec()
        velocity = seen.apply(motion.velocity) - np.cross(turn, self.v)
        residual = np.concatenate(
            [turn, motion.position - self.p, velocity - self.v]
        )
        self.cov = np.linalg.inv(np.linalg.inv(self.cov) + h.T @ weight @ h)
        error = self.cov @ h.T @ weight @ residual
        self.attitude = Rotation.from_rotvec(error[:3]) * self.attitude
        self.p, self.v, self.bias = (
            self.p + error[3:6],
            self.v + error[6:9],
            self.bias + error[9:],
        )
        self.rate = self.rate - self.share * error[9:12]
        other = SETTINGS.odometry.rate_noise**2
        self.rate = (self.rate / self.variance + motion.rate / other) / (
            1 / self.variance + 1 / other
        )
        self.variance = 1 / (1 / self.variance + 1 / other)

    def state(self):
        angles = self.attitude.as_euler("ZYX")[::-1]
        return np.concatenate(
            [angles, self.p, self.attitude.apply(self.rate), self.v]
        )


def held(value):
    """A single IMU sample, of which `value` are the first elements; it acts at any time."""
    return ImuSamples.none().followed(0, np.pad(value, (0, 6 - len(value))), 1)


def reading(truth, rng):
    """Odometry near the state of a plain filter."""
    noise = rng.normal(size=(4, 3)) * [[0.002], [0.001], [0.005], [0.02]]
    attitude = (Rotation.from_rotvec(noise[0]) * truth.attitude).as_quat()
    velocity = truth.attitude.inv().apply(truth.v) + noise[2]
    return OdometryMotion(
        0,
        attitude,
        truth.p + noise[1],
        velocity,
        truth.rate + noise[3],
        VARIANCE,
    )


def test_a_walk_agrees_with_the_plain_filter():
    """10 s: the state to rounding; the covariance as far as inverting it in the plain form can."""
    rng, still = np.random.default_rng(0), np.full((2, 3), [[0.1], [1.0]])
    attitude = Rotation.from_euler("ZYX", [2.5, 0.3, -0.4]).as_quat()
    place = np.array([1.0, -2.0, 0.06])
    motion = OdometryMotion(0, attitude, place, *still, VARIANCE)
    compiled, plain = InertialFilter(SETTINGS), PlainFilter(motion)
    compiled.restart(motion)
    for number in range(2000):  # swinging rates, impacts, gravity
        swing = 2 * np.pi * number * DT / 0.7 + np.arange(3)
        force = rng.normal(0, 2.0, 3) - DOWN
        sample = np.concatenate([1.5 * np.sin(swing), force])
        compiled.propagate(held(sample), 0, round(DT * SECOND))
        plain.propagate(sample)
        if number % 7 == 6:
            gyro, motion = sample[:3] + 0.1, reading(plain, rng)
            compiled.use_gyro(held(gyro), 0, 0.0)
            plain.use_gyro(gyro)
            compiled.correct(motion)
            plain.correct(motion)
            state, _ = compiled.output()
            np.testing.assert_allclose(state, plain.state(), rtol=0, atol=3e-11)
            scale = np.sqrt(np.diag(plain.cov))
            difference = (compiled.state.cov - plain.cov) / np.outer(
                scale, scale
            )
            assert np.abs(difference).max() < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_a_reading_after_a_blind_swing_is_followed_to_its_noise(seed):
    """The torso of a walk without IMU, 0.2 s after the reading before: 0.2 rad, 0.3 m/s off."""
    rng = np.random.default_rng(seed)
    level = np.array([0.0, 0.0, 0.0, 1.0])
    blind = InertialFilter(SETTINGS)
    blind.restart(OdometryMotion(0, level, *np.zeros((3, 3)), VARIANCE))
    blind.propagate_blind(0.2)
    angles, place, velocity, rate = rng.normal(size=(4, 3)) * [
        [0.2],
        [0.02],
        [0.3],
        [1.0],
    ]
    turn = Rotation.from_rotvec(angles)
    seen = OdometryMotion(0, turn.as_quat(), place, velocity, rate, VARIANCE)
    assert blind.correct(seen)
    state, _ = blind.output()
    wanted = [turn.as_euler("ZYX")[::-1], place, turn.apply(velocity)]
    off = np.abs(state[[0, 1, 2, 3, 4, 5, 9, 10, 11]] - np.concatenate(wanted))
    assert (off < 2.0 * np.repeat(DEVIATION[:3], 3)).all()


# odom tilted by 20 deg
STEEP = np.array([np.sin(0.35), 0.0, np.cos(0.35)]) * GRAVITY
LARGEST = SETTINGS.imu.acceleration_bias_max


@pytest.mark.parametrize(
    ("shown", "bias"),
    [
        (-DOWN + [0.0, 0.0, 0.4], [0.0, 0.0, 0.4]),
        (-DOWN + [0.0, 0.0, 6.0], [0.0, 0.0, LARGEST]),
        (-DOWN - [0.0, 0.0, 1.6], [0.0, 0.0, -LARGEST]),
        (STEEP, STEEP + DOWN),
    ],
)
def test_a_bias_up_to_the_data_sheets_and_any_tilt_of_odom_are_learned_and_no_more(
    shown, bias
):
    resting = OdometryMotion(
        0, np.array([0, 0, 0, 1.0]), *np.zeros((3, 3)), VARIANCE
    )
    learning = InertialFilter(SETTINGS)
    learning.restart(resting)
    sample = held(np.concatenate([np.zeros(3), shown]))
    for number in range(200):
        learning.propagate(sample, 0, round(DT * SECOND))
        if number % 7 == 6:
            learning.correct(resting)
    np.testing.assert_allclose(learning.state.bias[1], bias, atol=0.05)
