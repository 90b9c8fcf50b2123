"""Compiled filter against a plain one on scipy's rotations, and its Jacobians by differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.clock import SECOND
from slot_core.estimation.imu_samples import ImuSamples
from slot_core.estimation.inertial_filter import InertialFilter, OdometryMotion
from slot_core.estimation.state_estimator import read_estimator
from slot_core.robot import GRAVITY

SETTINGS = read_estimator()
DOWN = np.array([0.0, 0.0, -GRAVITY])
DT = 0.005  # s
NOISE = SETTINGS.odometry
VARIANCE = (
    np.repeat(
        [
            NOISE.angle_noise,
            NOISE.position_noise,
            NOISE.velocity_noise,
            NOISE.rate_noise,
        ],
        3,
    )
    ** 2
)
VARIANCE[6:9] *= [
    0.25,
    1.0,
    4.0,
]  # a visual SLAM may know one direction better than another


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
        self.cov[:9, :9], self.cov[9:, 9:] = h @ self.noise() @ h.T, np.diag(biases)
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
        q = DT / 2 * np.diag(np.repeat([*density, imu.acceleration_drift], 3) ** 2)
        f = np.eye(15) + a + a @ a / 2
        self.cov = f @ (self.cov + q) @ f.T + q

    def use_gyro(self, gyro):
        self.rate, self.share = gyro - self.bias[:3], 1.0
        self.variance = SETTINGS.imu.gyro_noise**2 * SETTINGS.imu.rate

    def correct(self, motion):
        h, weight = self.measurement(), np.linalg.inv(self.noise())
        residual = np.concatenate(
            [
                (Rotation.from_quat(motion.attitude) * self.attitude.inv()).as_rotvec(),
                motion.position - self.p,
                self.attitude.apply(motion.velocity) - self.v,
            ]
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
        return np.concatenate([angles, self.p, self.attitude.apply(self.rate), self.v])


def samples(rng, count):
    """IMU samples (count, 6) as of a walk: swinging rates, impacts, gravity."""
    t = DT * np.arange(count)[:, None]
    w = 1.5 * np.sin(2 * np.pi * t / 0.7 + [0.0, 1.0, 2.0])
    return np.hstack([w, rng.normal(0, 2.0, (count, 3)) - DOWN])


def held(value):
    """A single IMU sample, of which `value` are the first elements; it acts at any time."""
    return ImuSamples.none().followed(0, np.pad(value, (0, 6 - len(value))), 1)


def reading(truth, rng):
    """Odometry near the state of a plain filter."""
    noise = rng.normal(size=(4, 3)) * [[0.002], [0.001], [0.005], [0.02]]
    attitude = (Rotation.from_rotvec(noise[0]) * truth.attitude).as_quat()
    velocity = truth.attitude.inv().apply(truth.v) + noise[2]
    return OdometryMotion(
        0, attitude, truth.p + noise[1], velocity, truth.rate + noise[3], VARIANCE
    )


def start():
    attitude = Rotation.from_euler("ZYX", [2.5, 0.3, -0.4]).as_quat()
    return OdometryMotion(
        0, attitude, np.array([1.0, -2.0, 0.06]), np.full(3, 0.1), np.ones(3), VARIANCE
    )


def test_a_walk_agrees_with_the_plain_filter():
    """10 s: the state to rounding; the covariance as far as inverting it in the plain form can."""
    rng, motion = np.random.default_rng(0), start()
    compiled, plain = InertialFilter(SETTINGS), PlainFilter(motion)
    compiled.restart(motion)
    for number, sample in enumerate(samples(rng, 2000)):
        compiled.propagate(held(sample), 0, round(DT * SECOND))
        plain.propagate(sample)
        if number % 7 == 6:
            gyro, motion = sample[:3] + 0.1, reading(plain, rng)
            for each in (compiled, plain):
                each.use_gyro(*((held(gyro), 0, 0.0) if each is compiled else (gyro,)))
                each.correct(motion)
            state, cov = compiled.output()
            np.testing.assert_allclose(state, plain.state(), rtol=0, atol=3e-11)
            np.testing.assert_allclose(
                cov[3:6, 3:6], plain.cov[3:6, 3:6], rtol=1e-8, atol=1e-14
            )
            scale = np.sqrt(np.diag(plain.cov))
            difference = (compiled.state.cov - plain.cov) / np.outer(scale, scale)
            assert np.abs(difference).max() < 1e-9


def perturbed(state, error):
    """The nominal state with an error (15,) added."""
    attitude = (
        Rotation.from_rotvec(error[:3]) * Rotation.from_quat(state.attitude)
    ).as_quat()
    return state._replace(
        attitude=attitude,
        position=state.position + error[3:6],
        velocity=state.velocity + error[6:9],
        bias=state.bias + error[9:].reshape(2, 3),
    )


def error_between(a, b):
    """Error (15,) of b from a."""
    turn = Rotation.from_quat(b.attitude) * Rotation.from_quat(a.attitude).inv()
    parts = [
        b.position - a.position,
        b.velocity - a.velocity,
        (b.bias - a.bias).ravel(),
    ]
    return np.concatenate([turn.as_rotvec(), *parts])


def derivative(function, step):
    """Central differences of a vector function of an error (15,); (n, 15)."""
    rows = [(function(step * e) - function(-step * e)) / (2 * step) for e in np.eye(15)]
    return np.column_stack(rows)


@pytest.fixture
def noiseless():
    """A filter in a general state whose process noise is negligible, with a random covariance."""
    quiet = {f"imu.{name}": 1e-7 for name in ("gyro_noise", "acceleration_noise")}
    still = {"imu.gyro_drift": 0.0, "imu.acceleration_drift": 0.0}
    result = InertialFilter(config.replace(SETTINGS, quiet | still))
    result.restart(start())
    root = np.random.default_rng(1).normal(size=(15, 15))
    result.restore(result.state._replace(bias=np.full((2, 3), 0.05), cov=root @ root.T))
    return result


STEEP = np.array([np.sin(0.35), 0.0, np.cos(0.35)]) * GRAVITY  # odom tilted by 20 deg
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
    resting = OdometryMotion(0, np.array([0, 0, 0, 1.0]), *np.zeros((3, 3)), VARIANCE)
    learning = InertialFilter(SETTINGS)
    learning.restart(resting)
    for number in range(200):
        learning.propagate(
            held(np.concatenate([np.zeros(3), shown])), 0, round(DT * SECOND)
        )
        if number % 7 == 6:
            learning.correct(resting)
    np.testing.assert_allclose(learning.state.bias[1], bias, atol=0.05)


@pytest.mark.parametrize("bias", [0.05, LARGEST], ids=["sensor", "tilt of odom"])
def test_the_transition_is_the_derivative_of_the_propagation(noiseless, bias):
    noiseless.restore(
        noiseless.state._replace(bias=np.array([np.full(3, 0.05), np.full(3, bias)]))
    )
    before, sample = noiseless.state, np.array([0.9, -1.2, 0.5, 1.0, -2.0, 11.0])

    def after(error):
        noiseless.restore(perturbed(before, error))
        noiseless.propagate(held(sample), 0, round(DT * SECOND))
        return noiseless.state

    nominal = after(np.zeros(15))
    f = derivative(lambda error: error_between(nominal, after(error)), 1e-4)
    # neglected: (|w| DT)^2 / 6 of the gyro bias, DT^3 |f| / 6 of all others: below 1e-5
    np.testing.assert_allclose(nominal.cov, f @ before.cov @ f.T, rtol=0, atol=3e-4)
    assert np.abs(nominal.cov - before.cov).max() > 0.3  # what the transition did


def test_the_covariance_of_the_output_is_by_its_derivative(noiseless):
    before = noiseless.state

    def state(error):
        noiseless.restore(perturbed(before, error))
        noiseless.use_gyro(held(np.array([0.4, -0.8, 1.1])), 0, 0.0)
        return noiseless.output()[0]

    jacobian = derivative(state, 1e-5)
    state(np.zeros(15))
    _, cov = noiseless.output()
    np.testing.assert_allclose(
        cov, jacobian @ before.cov @ jacobian.T, rtol=0, atol=1e-6
    )
