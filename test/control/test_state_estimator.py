"""State estimator against closed-form motion and chi-square statistics; order of arrival."""

import numpy as np
import pytest
from estimator_streams import (
    EXACT,
    GYRO_BIAS,
    MATCHED,
    SETTINGS,
    Walk,
    arrivals,
    clean,
    error,
    imu_messages,
    noisy,
    odometry_messages,
    run,
    same,
)
from scipy import stats
from scipy.spatial.transform import Rotation

from slot_core.clock import SECOND
from slot_core.estimation.state_estimator import StateEstimator
from slot_core.robot import GRAVITY

# --- accuracy ---


def test_dead_reckoning_error_falls_with_the_square_of_the_imu_interval():
    """One reading, then only the IMU for 0.4 s: the midpoint rule is of second order."""
    motion, errors = Walk(), []
    first = odometry_messages(motion, 0.1)[:1]
    for rate in (200, 400, 800):
        _, estimator = run(arrivals(imu_messages(motion, 0.4, rate), first), EXACT)
        errors.append(np.abs(error(estimator.present(), motion)[3:6]).max())
    order = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(np.abs(order - 2) < 0.1)  # the next order's share at 200 Hz
    # h^2/12 |f''| t^2/2 with |f''| = omega^2 f_0 + |w|^2 g = 100 m/s^4
    assert errors[0] < 1e-4


CASES = {
    "all states, many walks": (40, 1.0, slice(-1, None), slice(0, 12)),
    "rates, over one walk": (1, 10.0, slice(30, 300), slice(6, 9)),
    "rates, while the bias converges": (100, 4 / 30, slice(3, 4), slice(6, 9)),
}


@pytest.mark.parametrize("case", CASES)
def test_errors_are_consistent_with_the_covariance(case):
    """NEES of independent errors: the sum is chi-square.

    The bound is the central 99.9 %; the seeds are fixed, so the outcome is. The tilt varies over an
    odometry interval, so a wrong noise or Jacobian changes the sum by far more than the bound. The
    noise of omega is independent at every reading.
    """
    (walks, duration, readings, states), nees = CASES[case], []
    for seed in range(walks):
        bias = np.random.default_rng(seed).normal(0, MATCHED.imu.gyro_bias, 3)
        motion = Walk(yaw=0.3 * seed)
        messages = noisy(motion, duration + 0.01 * seed % 0.4, 100 + seed, bias)
        for estimate in run(messages, MATCHED)[0][readings]:
            e = error(estimate, motion)[states]
            nees.append(e @ np.linalg.solve(estimate.covariance[states, states], e))
    low, high = stats.chi2.ppf([0.0005, 0.9995], len(e) * len(nees))
    assert len(nees) >= 40
    assert low < sum(nees) < high


# --- conventions ---


def test_angles_and_twist_follow_the_conventions():
    rng = np.random.default_rng(5)
    for _ in range(20):
        rpy = rng.uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1])
        about_x, about_y, about_z = map(Rotation.from_rotvec, np.diag(rpy))
        attitude = about_z * about_y * about_x
        p, v, w = rng.normal(size=(3, 3))
        estimator = StateEstimator(SETTINGS)
        estimator.add_imu(0, w, [0.0, 0.0, GRAVITY])
        # -q is the same attitude
        estimator.add_odometry(0, p, -attitude.as_quat(), v, w)
        expected = [*rpy, *p, *attitude.apply(w), *attitude.apply(v)]
        # rounding, cos(pitch) > 0.07
        np.testing.assert_allclose(estimator.poll().state, expected, atol=1e-12)


def test_covariance_stays_positive_at_a_pitch_of_90_deg():
    motion = Walk()
    motion.offset[1] = np.pi / 2
    for estimate in run(clean(motion, 1.0))[0]:
        assert np.all(np.isfinite(estimate.state))
        scale = np.sqrt(np.diag(estimate.covariance))
        correlation = estimate.covariance / np.outer(scale, scale)
        # rounding of a 12 x 12 product
        assert np.linalg.eigvalsh(correlation)[0] > -1e-9


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
