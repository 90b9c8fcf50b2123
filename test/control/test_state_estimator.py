"""State estimator against closed-form motion and chi-square statistics; order of arrival."""

import numpy as np
import pytest
from estimator_streams import (
    EXACT,
    GYRO_BIAS,
    MATCHED,
    SETTINGS,
    Spin,
    Walk,
    arrivals,
    clean,
    error,
    imu_messages,
    noisy,
    odometry_messages,
    run,
    same,
    without_odometry,
)
from scipy import stats
from scipy.spatial.transform import Rotation

from slot_core.clock import SECOND
from slot_core.estimation.estimate import Validity
from slot_core.estimation.state_estimator import StateEstimator
from slot_core.robot import GRAVITY

# --- accuracy ---


def test_dead_reckoning_error_falls_with_the_square_of_the_imu_interval():
    """One reading, then only the IMU for 0.4 s: the midpoint rule is of second order."""
    motion, errors = Spin(), []
    for rate in (200, 400, 800):
        messages = arrivals(
            imu_messages(motion, 0.4, rate), odometry_messages(motion, 0.4, 25)
        )
        estimates, _ = run(without_odometry(messages), EXACT)
        assert len(estimates) == 10
        errors.append(np.abs(error(estimates[-1], motion)[3:6]).max())
    order = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(np.abs(order - 2) < 0.1)  # the next order's share at 200 Hz
    assert (
        errors[0] < 1e-4
    )  # h^2/12 |f''| t^2/2 with |f''| = omega^2 f_0 + |w|^2 g = 100 m/s^4


def test_without_noise_the_error_is_the_discretisation_error():
    motion = Walk()
    estimates, _ = run(clean(motion, 3.0))
    errors = np.array(
        [error(e, motion) for e in estimates if e.validity == Validity.VALID]
    )
    rms = np.sqrt(np.mean(errors**2, axis=0)).reshape(4, 3).max(axis=1)
    # angle, p and v: far below the odometry's noise; omega: third derivative of the tilt times
    # the square of the interval, 0.22 rad (2 pi / 0.7 s)^3 (5 ms)^2 = 4e-3 rad/s
    assert np.all(rms < [1e-4, 2e-5, 4e-3, 2e-4]), rms


def test_errors_are_consistent_with_the_covariance():
    """NEES of 40 independent walks at one instant each: the sum is chi-square with 480 degrees.

    The bound is the central 99.9 %; the seeds are fixed, so the outcome is. The tilt varies over an
    odometry interval, so a wrong noise or Jacobian changes the sum by far more than the bound.
    """
    nees, inside = [], []
    for seed in range(40):
        motion = Walk(yaw=0.3 * seed)
        last = run(noisy(motion, 1.0 + 0.01 * seed, seed, GYRO_BIAS), MATCHED)[0][-1]
        assert last.validity == Validity.VALID
        e = error(last, motion)
        nees.append(e @ np.linalg.solve(last.covariance, e))
        inside.append(np.abs(e) < 3 * np.sqrt(np.diag(last.covariance)))
    low, high = stats.chi2.ppf([0.0005, 0.9995], 12 * len(nees))
    assert low < sum(nees) < high
    # of 480 draws 0.27 % are expected outside: 1.3; more than 6 have a probability of 1e-3
    assert np.sum(~np.array(inside)) <= 6


@pytest.mark.parametrize(("walks", "first", "last"), [(1, 30, 300), (100, 3, 4)])
def test_rates_are_consistent_with_their_covariance(walks, first, last):
    """NEES of omega over one walk, and over many just after the start while the bias converges.

    The noise of omega is independent at every reading, so the sum is chi-square; central 99.9 %.
    """
    nees = []
    for seed in range(walks):
        bias = np.random.default_rng(seed).normal(0, MATCHED.imu.gyro_bias, 3)
        motion = Walk(yaw=0.3 * seed)
        for estimate in run(noisy(motion, last / 30, 100 + seed, bias), MATCHED)[0][
            first:last
        ]:
            e = error(estimate, motion)[6:9]
            nees.append(e @ np.linalg.solve(estimate.covariance[6:9, 6:9], e))
    low, high = stats.chi2.ppf([0.0005, 0.9995], 3 * len(nees))
    assert len(nees) == walks * (last - first)
    assert low < sum(nees) < high


# --- conventions ---


def test_angles_and_twist_follow_the_conventions():
    rng = np.random.default_rng(5)
    for _ in range(20):
        roll, pitch, yaw = rng.uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1])
        attitude = Rotation.from_matrix(
            Rotation.from_rotvec([0, 0, yaw]).as_matrix()
            @ Rotation.from_rotvec([0, pitch, 0]).as_matrix()
            @ Rotation.from_rotvec([roll, 0, 0]).as_matrix()
        )
        p, v, w = rng.normal(size=(3, 3))
        estimator = StateEstimator(SETTINGS)
        estimator.add_imu(0, w, [0.0, 0.0, GRAVITY])
        estimator.add_odometry(
            0, p, -attitude.as_quat(), v, w
        )  # -q is the same attitude
        state = estimator.poll().state
        expected = np.concatenate(
            [[roll, pitch, yaw], p, attitude.apply(w), attitude.apply(v)]
        )
        np.testing.assert_allclose(
            state, expected, atol=1e-12
        )  # rounding, cos(pitch) > 0.07


def test_covariance_stays_positive_at_a_pitch_of_90_deg():
    motion = Walk()
    motion.offset[1] = np.pi / 2
    estimates, _ = run(clean(motion, 1.0))
    for estimate in estimates:
        assert np.all(np.isfinite(estimate.state))
        scale = np.sqrt(np.diag(estimate.covariance))
        correlation = estimate.covariance / np.outer(scale, scale)
        assert (
            np.linalg.eigvalsh(correlation)[0] > -1e-9
        )  # rounding of a 12 x 12 product


# --- order of arrival ---


@pytest.mark.parametrize("seed", range(5))
def test_the_filter_does_not_depend_on_the_interleaving_of_the_streams(seed):
    """Both streams are late by up to 30 ms, less than one odometry period.

    Estimates of one tick predicted to the same time are equal to the last bit, and so is the state
    at the end.
    """
    messages = noisy(Walk(), 2.0, 3, GYRO_BIAS)
    rng, late = np.random.default_rng(seed), {"imu": 0.0, "odometry": 0.0}
    arrival = []
    for kind, stamp, _ in messages:
        late[kind] = max(late[kind], stamp + rng.uniform(0, 0.03) * SECOND)
        arrival.append(late[kind])
    shuffled = [messages[i] for i in np.argsort(arrival, kind="stable")]
    assert [m[1] for m in shuffled] != [m[1] for m in messages]
    (expected, one), (estimates, other) = run(messages), run(shuffled)
    assert [e.stamp for e in estimates] == [e.stamp for e in expected]
    alike = [(a, b) for a, b in zip(estimates, expected) if a.time == b.time]
    assert len(alike) > 5
    assert same(*zip(*alike))
    assert same([other.present()], [one.present()])


def test_a_reading_waits_for_the_imu_to_reach_its_stamp():
    messages = clean(Walk(), 0.5)
    estimator = StateEstimator(SETTINGS)
    for kind, stamp, values in messages:
        if kind == "imu":
            estimator.add_imu(stamp, *values)
    last = messages[-1][1]
    reading = odometry_messages(Walk(), 0.1)[0][2]
    estimator.add_odometry(last + 1, *reading)
    assert estimator.poll() is None
    estimator.add_imu(last + 1, [0.0, 0.0, 0.0], [0.0, 0.0, GRAVITY])
    assert estimator.poll().stamp == last + 1
