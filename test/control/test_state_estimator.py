"""State estimator against closed-form motion, chi-square statistics and bad data."""

import dataclasses

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.clock import SECOND
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.estimation.state_estimator import StateEstimator, read_estimator
from slot_core.geometry import wrapped
from slot_core.robot import GRAVITY

UP = np.array([0.0, 0.0, GRAVITY])
# without the prediction beyond the newest sample, which has a test of its own
SETTINGS = config.replace(read_estimator(), {"timing.command_delay": 0.0})
GYRO_BIAS = np.array([0.02, -0.015, 0.01])
GYRO_NOISE, FORCE_NOISE = 0.01, 0.3  # of one sample at 200 Hz, as in MATCHED
MATCHED = config.replace(
    SETTINGS,
    {
        "imu.gyro_noise": GYRO_NOISE / 200**0.5,
        "imu.acceleration_noise": FORCE_NOISE / 200**0.5,
        "imu.acceleration_bias": 0.1,
        "imu.angular_acceleration_step": 1.0,  # of the sinusoids: 0.22 rad (2 pi / 0.7 s)^3 5 ms
    },
)
EXACT = config.replace(SETTINGS, {"imu.gyro_bias": 0.0, "imu.acceleration_bias": 0.0})


class Walk:
    """Sinusoids in roll, pitch, yaw and position, with the walk's amplitudes and frequencies."""

    def __init__(self, tilt=0.22, frequency=1 / 0.7, sway=0.01, speed=0.05, yaw=0.3):
        self.amplitude = np.array([tilt, tilt, 0.05, sway, sway, sway])
        self.omega = 2 * np.pi * frequency * np.array([1.0, 1.0, 0.5, 1.0, 1.0, 2.0])
        self.phase = np.array([0.0, 1.1, 0.4, 0.2, 1.9, 0.7])
        self.offset = np.array([0.0, 0.0, yaw, 0.0, 0.0, 0.06])
        self.drift = np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0])

    def at(self, t):
        """State (12,), attitude, angular velocity and specific force in base_link at t."""
        angle = self.omega * t + self.phase
        q = self.offset + self.drift * t + self.amplitude * np.sin(angle)
        dq = self.drift + self.amplitude * self.omega * np.cos(angle)
        ddq = -self.amplitude * self.omega**2 * np.sin(angle)
        attitude = Rotation.from_euler("ZYX", q[2::-1])
        # rates of the intrinsic z, y', x'' angles add along their own axes
        axes = [
            attitude.as_matrix()[:, 0],
            Rotation.from_euler("Z", q[2]).as_matrix()[:, 1],
            np.array([0.0, 0.0, 1.0]),
        ]
        omega = dq[0] * axes[0] + dq[1] * axes[1] + dq[2] * axes[2]
        force = attitude.inv().apply(ddq[3:] + UP)
        state = np.concatenate([q, omega, dq[3:]])
        return state, attitude, attitude.inv().apply(omega), force


class Spin(Walk):
    """Constant rotation about a tilted axis, sinusoidal translation."""

    AXIS = np.array([0.6, -0.9, 1.4])  # rad/s, in base_link

    def at(self, t):
        state, _, _, _ = super().at(t)
        attitude = Rotation.from_rotvec(self.AXIS * t)
        acceleration = -self.amplitude[3:] * self.omega[3:] ** 2
        acceleration = acceleration * np.sin(self.omega[3:] * t + self.phase[3:])
        force = attitude.inv().apply(acceleration + UP)
        state[:3] = attitude.as_euler("ZYX")[::-1]
        state[6:9] = attitude.apply(self.AXIS)
        return state, attitude, self.AXIS, force


def imu_messages(motion, duration, rate=200, rng=None, bias=0.0):
    messages = []
    for k in range(round(duration * rate) + 1):
        _, _, w, f = motion.at(k / rate)
        if rng is not None:
            w, f = w + rng.normal(0, GYRO_NOISE, 3), f + rng.normal(0, FORCE_NOISE, 3)
        messages.append(("imu", k * SECOND // rate, (w + bias, f)))
    return messages


def odometry_messages(motion, duration, rate=30, rng=None, noise=SETTINGS.odometry):
    messages = []
    for k in range(round(duration * rate)):
        stamp = k * SECOND // rate
        state, attitude, w, _ = motion.at(stamp / SECOND)
        p, v = state[3:6], attitude.inv().apply(state[9:])
        if rng is not None:
            attitude = Rotation.from_rotvec(rng.normal(0, noise.angle_noise, 3)) * attitude
            p = p + rng.normal(0, noise.position_noise, 3)
            v = v + rng.normal(0, noise.velocity_noise, 3)
            w = w + rng.normal(0, noise.rate_noise, 3)
        messages.append(("odometry", stamp, (p, attitude.as_quat(), v, w)))
    return messages


def arrivals(*streams):
    """The messages of all streams in order of the stamps; at equal stamps the IMU is first."""
    return sorted((m for s in streams for m in s), key=lambda m: (m[1], m[0]))


def run(messages, settings=SETTINGS):
    """Estimates and estimator after all messages; polled after each message."""
    estimator = StateEstimator(settings)
    estimates: list[Estimate] = []
    for kind, stamp, values in messages:
        (estimator.add_imu if kind == "imu" else estimator.add_odometry)(stamp, *values)
        while (estimate := estimator.poll()) is not None:
            estimates.append(estimate)
    return estimates, estimator


def error(estimate, motion):
    """Estimate minus truth (12,), angles wrapped."""
    difference = estimate.state - motion.at(estimate.time / SECOND)[0]
    difference[:3] = wrapped(difference[:3])
    return difference


def noisy(motion, duration, seed, bias=0.0):
    rng = np.random.default_rng(seed)
    return arrivals(
        imu_messages(motion, duration, rng=rng, bias=bias),
        odometry_messages(motion, duration, rng=rng),
    )


def clean(motion, duration):
    return arrivals(imu_messages(motion, duration), odometry_messages(motion, duration))


def without_odometry(messages, keep=1):
    """The messages with every odometry reading after the first `keep` made unusable."""
    count, result = 0, []
    for kind, stamp, values in messages:
        count += kind == "odometry"
        damage = kind == "odometry" and count > keep
        result.append((kind, stamp, (np.full(3, np.nan), *values[1:]) if damage else values))
    return result


def with_jump(messages, start, shift, stop=np.inf):
    """The messages with the odometry positions from `start` to `stop` shifted by `shift` m."""
    count, result = -1, []
    for kind, stamp, values in messages:
        count += kind == "odometry"
        if kind == "odometry" and start <= count < stop:
            values = (values[0] + shift, *values[1:])  # noqa: PLW2901
        result.append((kind, stamp, values))
    return result


def validities(estimates):
    return [e.validity for e in estimates]


# --- accuracy ---


def test_dead_reckoning_error_falls_with_the_square_of_the_imu_interval():
    """One reading, then only the IMU for 0.4 s: the midpoint rule is of second order."""
    motion, errors = Spin(), []
    for rate in (200, 400, 800):
        messages = arrivals(imu_messages(motion, 0.4, rate), odometry_messages(motion, 0.4, 25))
        estimates, _ = run(without_odometry(messages), EXACT)
        assert len(estimates) == 10
        errors.append(np.abs(error(estimates[-1], motion)[3:6]).max())
    order = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(np.abs(order - 2) < 0.1)  # the next order's share at 200 Hz
    assert errors[0] < 1e-4  # h^2/12 |f''| t^2/2 with |f''| = omega^2 f_0 + |w|^2 g = 100 m/s^4


def test_constant_rate_and_acceleration_are_integrated_exactly():
    """A constant IMU signal about the vertical is integrated without error."""
    motion = Walk(tilt=0.0, sway=0.0)
    motion.amplitude[:] = 0.0
    motion.drift[2] = 1.5  # turns about the vertical, moves straight
    estimates, _ = run(without_odometry(clean(motion, 0.4)), EXACT)
    worst = max(np.abs(error(e, motion)).max() for e in estimates)
    assert worst < 1e-8  # stamps are whole ns: 1 ns * 1.5 rad/s


def test_without_noise_the_error_is_the_discretisation_error():
    motion = Walk()
    estimates, _ = run(clean(motion, 3.0))
    errors = np.array([error(e, motion) for e in estimates if e.validity == Validity.VALID])
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
        for estimate in run(noisy(motion, last / 30, 100 + seed, bias), MATCHED)[0][first:last]:
            e = error(estimate, motion)[6:9]
            nees.append(e @ np.linalg.solve(estimate.covariance[6:9, 6:9], e))
    low, high = stats.chi2.ppf([0.0005, 0.9995], 3 * len(nees))
    assert len(nees) == walks * (last - first)
    assert low < sum(nees) < high


@pytest.mark.parametrize("readings", [1, 4])
def test_large_errors_propagate_through_the_states_consistently_with_the_covariance(readings):
    """NEES after 0.4 s from an attitude error of 2 deg: one reading or four, then only the IMU.

    At 2 m/s and an angle error of 0.03 rad, every coupling of the linear model outweighs the noise:
    gravity into v, attitude into velocities and rates, biases into all. 60 runs, 99.9 %.
    """
    settings = config.replace(MATCHED, {"odometry.angle_noise": 0.03})
    nees = []
    for seed in range(60):
        rng, motion = np.random.default_rng(seed), Walk(speed=2.0, yaw=0.3 * seed)
        imu_bias = rng.normal(0, settings.imu.gyro_bias, 3)
        imu = imu_messages(motion, 0.4, rng=rng, bias=imu_bias)
        force_bias = rng.normal(0, settings.imu.acceleration_bias, 3)
        imu = [(kind, stamp, (w, f + force_bias)) for kind, stamp, (w, f) in imu]
        odometry = odometry_messages(motion, 0.4, rng=rng, noise=settings.odometry)
        last = run(without_odometry(arrivals(imu, odometry), readings), settings)[0][-1]
        e = error(last, motion)
        nees.append(e @ np.linalg.solve(last.covariance, e))
    low, high = stats.chi2.ppf([0.0005, 0.9995], 12 * len(nees))
    assert low < sum(nees) < high


def test_position_velocity_and_angles_are_better_than_the_raw_odometry():
    motion = Walk()
    messages = noisy(motion, 10.0, 1, GYRO_BIAS)
    estimates, _ = run(messages, MATCHED)
    errors = np.array([error(e, motion) for e in estimates[30:]])
    rms = np.sqrt(np.mean(errors**2, axis=0)).reshape(4, 3).mean(axis=1)
    noise = SETTINGS.odometry
    # the IMU relates successive readings; a filter is worthwhile if it is better by a fifth
    assert rms[1] < 0.8 * noise.position_noise
    assert rms[0] < 0.8 * noise.angle_noise
    assert rms[3] < 0.95 * noise.velocity_noise
    assert rms[2] < 0.8 * noise.rate_noise


def test_the_gyro_bias_is_estimated():
    _, estimator = run(noisy(Walk(), 10.0, 2, GYRO_BIAS), MATCHED)
    # two angles of 2 mrad, 10 s apart, with gyro noise 0.01 rad/s at 200 Hz in between: 3e-4 rad/s
    assert np.abs(estimator.gyro_bias - GYRO_BIAS).max() < 1.2e-3


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
        estimator.add_odometry(0, p, -attitude.as_quat(), v, w)  # -q is the same attitude
        state = estimator.poll().state
        expected = np.concatenate([[roll, pitch, yaw], p, attitude.apply(w), attitude.apply(v)])
        np.testing.assert_allclose(state, expected, atol=1e-12)  # rounding, cos(pitch) > 0.07


def test_covariance_stays_positive_at_a_pitch_of_90_deg():
    motion = Walk()
    motion.offset[1] = np.pi / 2
    estimates, _ = run(clean(motion, 1.0))
    for estimate in estimates:
        assert np.all(np.isfinite(estimate.state))
        scale = np.sqrt(np.diag(estimate.covariance))
        correlation = estimate.covariance / np.outer(scale, scale)
        assert np.linalg.eigvalsh(correlation)[0] > -1e-9  # rounding of a 12 x 12 product


# --- order of arrival ---


def same(a, b):
    return [(e.stamp, e.state.tobytes(), e.covariance.tobytes(), e.validity) for e in a] == [
        (e.stamp, e.state.tobytes(), e.covariance.tobytes(), e.validity) for e in b
    ]


def arriving(messages, delay):
    """The messages in the order of their arrival, `delay(kind)` s after their stamps."""
    at = [stamp + delay(kind) * SECOND for kind, stamp, _ in messages]
    return [messages[i] for i in np.argsort(at, kind="stable")]


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


def test_estimates_do_not_depend_on_when_they_are_polled():
    messages = noisy(Walk(), 1.0, 3)
    estimator = StateEstimator(SETTINGS)
    for kind, stamp, values in messages:
        (estimator.add_imu if kind == "imu" else estimator.add_odometry)(stamp, *values)
    estimates = list(iter(estimator.poll, None))
    assert same(estimates, run(messages)[0])


def test_an_estimate_does_not_depend_on_samples_after_its_time():
    messages = noisy(Walk(), 1.0, 3)
    stamp = run(messages)[0][20].time
    other = [
        (k, t, (v[0] + 1.0, *v[1:])) if k == "imu" and t > stamp else (k, t, v)
        for k, t, v in messages
    ]
    assert same(run(messages)[0][:21], run(other)[0][:21])
    assert not same(run(messages)[0][:22], run(other)[0][:22])


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


# --- delay and loss of the odometry ---


def rms_at_use(estimates, motion):
    """RMS error of angles, position, angular velocity and velocity at the estimates' times."""
    errors = np.array([error(e, motion) for e in estimates])
    return np.sqrt(np.mean(errors**2, axis=0)).reshape(4, 3).mean(axis=1)


def test_a_delay_of_the_odometry_with_jitter_costs_only_what_the_imu_drifts():
    """80 ms +- 20 ms: the state at the newest sample, beside that without any delay."""
    motion, rng = Walk(), np.random.default_rng(1)
    messages = noisy(motion, 10.0, 1, GYRO_BIAS)
    late = arriving(messages, lambda kind: rng.uniform(0.06, 0.1) if kind == "odometry" else 0.0)
    prompt, delayed = run(messages, MATCHED)[0][30:], run(late, MATCHED)[0][30:]
    leads = np.array([e.lead for e in delayed[:-4]]) / SECOND  # the IMU ends with the odometry
    assert leads.min() > 0.055
    assert leads.max() < 0.105
    # of velocity: 0.3 m/s^2 sqrt(5 ms) sqrt(80 ms) = 6 mm/s more, in quadrature
    rms, without = rms_at_use(delayed, motion), rms_at_use(prompt, motion)
    assert np.all(rms < np.hypot(without, [2e-3, 5e-4, 0.0, 6e-3]) * 1.1), (rms, without)


def test_a_reading_overtaken_by_a_newer_one_is_dropped_without_harm():
    motion = Walk()
    messages = noisy(motion, 2.0, 3)
    index = [i for i, m in enumerate(messages) if m[0] == "odometry"][20:22]
    overtaken = messages[: index[0]] + messages[index[0] + 1 : index[1] + 1]
    overtaken += [messages[index[0]], *messages[index[1] + 1 :]]
    lost = [m for i, m in enumerate(messages) if i != index[0]]
    assert same(run(overtaken)[0], run(lost)[0])


def test_lost_odometry_is_flagged_in_time_and_the_imu_carries_on_for_a_second():
    motion, timing, period = Walk(), SETTINGS.timing, SETTINGS.odometry.period
    lost = [
        m
        for m in noisy(motion, 8.0, 3, GYRO_BIAS)
        if m[0] == "imu" or not 5.0 < m[1] / SECOND < 6.0
    ]
    estimates, _ = run(lost, MATCHED)
    flagged = [e for e in estimates if e.validity == Validity.ODOMETRY_LOST]
    assert 5.0 + timing.odometry_wait < flagged[0].time / SECOND
    assert flagged[0].time / SECOND < 5.0 + period + timing.odometry_wait + 2 * 0.005
    np.testing.assert_allclose(np.diff([e.stamp for e in flagged]) / SECOND, period, atol=1e-8)
    worst = np.abs([error(e, motion) for e in flagged]).max(axis=0)
    assert worst[3:6].max() < 0.05
    assert worst[9:12].max() < 0.05
    after = [e for e in estimates if e.stamp / SECOND > 6.0]
    assert set(validities(after)) == {Validity.VALID}


def test_without_odometry_for_longer_the_estimates_end():
    messages = [m for m in noisy(Walk(), 5.0, 3) if m[0] == "imu" or m[1] < 2 * SECOND]
    estimates, estimator = run(messages)
    assert 0 <= 2.0 + SETTINGS.timing.odometry_gap - estimates[-1].time / SECOND < 0.07
    assert estimator.present() is None


def test_the_stamps_of_the_estimates_increase_whatever_arrives():
    motion, rng = Walk(), np.random.default_rng(2)
    kept = [m for m in noisy(motion, 20.0, 3) if m[0] == "imu" or rng.random() < 0.3]
    late = arriving(kept, lambda kind: rng.uniform(0.0, 0.3) if kind == "odometry" else 0.0)
    estimates, _ = run(late)
    assert min(np.diff([e.stamp for e in estimates])) > 0
    assert min(np.diff([e.time for e in estimates])) >= 0
    assert {Validity.VALID, Validity.ODOMETRY_LOST} <= set(validities(estimates))


def test_the_state_is_predicted_beyond_the_newest_sample_by_the_delay_of_the_command():
    motion = Walk()
    settings = config.replace(SETTINGS, {"timing.command_delay": 0.01})
    ahead, now = run(clean(motion, 2.0), settings)[0][20:], run(clean(motion, 2.0))[0][20:]
    assert {a.time - b.time for a, b in zip(ahead, now)} == {10_000_000}
    # angle, position, rate, velocity: third derivatives by the square of 10 ms
    assert np.all(rms_at_use(ahead, motion) < [2e-3, 1e-4, 0.2, 5e-3])
    held = [dataclasses.replace(b, lead=a.lead) for a, b in zip(ahead, now)]
    assert rms_at_use(held, motion)[0] > 2 * rms_at_use(ahead, motion)[0]


def test_the_present_state_follows_every_imu_sample():
    motion, estimator, count = Walk(), StateEstimator(SETTINGS), 0
    assert estimator.present() is None
    for kind, stamp, values in clean(motion, 2.0):
        (estimator.add_imu if kind == "imu" else estimator.add_odometry)(stamp, *values)
        present = estimator.present() if kind == "imu" else None
        if present is not None and present.validity == Validity.VALID:
            assert present.time == stamp
            assert np.abs(error(present, motion)[3:6]).max() < 2e-4
            count += 1
    assert count > 280


def test_an_imu_mounted_elsewhere_gives_the_same_estimates():
    """Turned by 90 deg, 0.1 m off the centre; the rotation is constant: no angular acceleration."""
    motion, r = Spin(), np.array([0.1, -0.05, 0.03])
    turn = Rotation.from_euler("xyz", [0.0, 0.3, np.pi / 2])
    mounted = []
    for kind, stamp, values in clean(motion, 2.0):
        if kind == "imu":
            w, f = values
            values = turn.inv().apply([w, f + np.cross(w, np.cross(w, r))])  # noqa: PLW2901
        mounted.append((kind, stamp, values))
    mount = {"mounts.imu.position": tuple(r), "mounts.imu.rpy": (0.0, 0.3, np.pi / 2)}
    found, _ = run(mounted, config.replace(SETTINGS, mount))
    for estimate, expected in zip(found, run(clean(motion, 2.0))[0], strict=True):
        np.testing.assert_allclose(estimate.state, expected.state, atol=1e-9)


def test_the_state_after_a_gap_of_the_imu_is_as_uncertain_as_it_is_wrong():
    """60 ms without IMU and odometry, then the IMU again: a part of a swing is missed."""
    motion = Walk()
    kept = [m for m in noisy(motion, 1.1, 3) if m[1] <= SECOND or (m[0] == "imu" and m[1] > 1.06e9)]
    _, estimator = run(kept, MATCHED)
    present = estimator.present()
    assert np.all(np.abs(error(present, motion)) < 5 * np.sqrt(np.diag(present.covariance)))


# --- noise of a reading ---


def with_variance(messages, variance, index):
    """The messages with the variance (12,) of one odometry reading."""
    place = [i for i, m in enumerate(messages) if m[0] == "odometry"][index]
    kind, stamp, values = messages[place]
    return [*messages[:place], (kind, stamp, (*values, variance)), *messages[place + 1 :]]


@pytest.mark.parametrize("unknown", [0.0, -1.0, np.nan])
def test_an_unknown_variance_is_that_of_the_settings(unknown):
    messages = noisy(Walk(), 1.0, 3)
    given = with_variance(messages, np.full(12, unknown), 20)
    assert same(run(given)[0], run(messages)[0])


def test_an_uncertain_reading_has_no_weight_and_is_no_outlier():
    motion, shift = Walk(), np.array([0.1, 0.0, 0.0])
    messages = with_jump(clean(motion, 1.0), 20, shift, 21)
    estimates, _ = run(with_variance(messages, np.full(12, np.inf), 20))
    assert set(validities(estimates[15:])) == {Validity.VALID}
    assert max(np.abs(error(e, motion)[3:6]).max() for e in estimates) < 2e-4


def test_a_certain_reading_is_followed():
    motion, shift = Walk(), np.array([0.0005, 0.0, 0.0])
    messages = with_jump(clean(motion, 1.0), 20, shift, 21)
    certain = run(with_variance(messages, np.full(12, 1e-10), 20))[0][20]
    np.testing.assert_allclose(error(certain, motion)[3], 0.0005, atol=5e-5)
    assert error(run(messages)[0][20], motion)[3] < 0.0002


# --- validity ---


def test_valid_after_the_initial_readings_and_not_before():
    n = SETTINGS.gate.initial_readings
    found = validities(run(clean(Walk(), 1.0))[0])
    assert found[: n - 1] == [Validity.INITIALISING] * (n - 1)
    assert set(found[n - 1 :]) == {Validity.VALID}


def test_a_rejection_while_initialising_restarts_the_count():
    n = SETTINGS.gate.initial_readings
    found = validities(run(with_jump(clean(Walk(), 1.0), n - 2, 0.1, n - 1))[0])
    assert found[n - 2] == Validity.ODOMETRY_REJECTED
    assert found[n - 1 : 2 * n - 2] == [Validity.INITIALISING] * (n - 1)
    assert set(found[2 * n - 2 :]) == {Validity.VALID}


def test_a_single_jump_is_rejected_and_does_not_affect_the_position():
    motion, shift = Walk(), np.array([0.1, 0.0, 0.0])
    estimates, _ = run(with_jump(clean(motion, 1.0), 15, shift, 16))
    assert [i for i, v in enumerate(validities(estimates)) if v == Validity.ODOMETRY_REJECTED] == [
        15
    ]
    assert np.abs(error(estimates[15], motion)[3:6]).max() < 2e-4  # one IMU-only step
    assert estimates[15].covariance[3, 3] > estimates[14].covariance[3, 3]


def test_relocalised_odometry_is_accepted_after_the_configured_number_of_rejections():
    motion, shift, n = Walk(), np.array([0.3, -0.2, 0.1]), SETTINGS.gate.max_rejections
    estimates, _ = run(with_jump(clean(motion, 2.0), 30, shift))
    found = validities(estimates)
    assert found[30 : 30 + n - 1] == [Validity.ODOMETRY_REJECTED] * (n - 1)
    first = 30 + n - 1
    initial = SETTINGS.gate.initial_readings
    assert found[first : first + initial - 1] == [Validity.INITIALISING] * (initial - 1)
    assert set(found[first + initial - 1 :]) == {Validity.VALID}
    offset = error(estimates[-1], motion)[3:6] - shift
    assert np.abs(offset).max() < 2e-4  # as without a jump


def test_readings_that_alternate_between_two_positions_are_not_accepted():
    motion = Walk()
    messages = clean(motion, 1.3)
    for k in range(20, 39, 2):
        messages = with_jump(messages, k, np.array([0.2, 0, 0]), k + 1)
        messages = with_jump(messages, k + 1, np.array([-0.2, 0, 0]), k + 2)
    estimates, _ = run(messages)
    gap = SETTINGS.timing.odometry_gap
    coasting = [e for e in estimates[20:] if e.stamp / SECOND < 19 / 30 + gap]
    assert set(validities(coasting)) == {Validity.ODOMETRY_REJECTED}
    assert Validity.VALID not in validities(estimates[20:])


BAD = {
    "nan position": lambda p, q, v, w: (p * np.nan, q, v, w),
    "inf velocity": lambda p, q, v, w: (p, q, v + np.inf, w),
    "nan rate": lambda p, q, v, w: (p, q, v, w * np.nan),
    "huge position": lambda p, q, v, w: (p + 1e300, q, v, w),
    "zero quaternion": lambda p, q, v, w: (p, q * 0, v, w),
    "quaternion of norm 1.1": lambda p, q, v, w: (p, q * 1.1, v, w),
    "short position": lambda p, q, v, w: (p[:2], q, v, w),
    "quaternion as matrix": lambda p, q, v, w: (p, np.eye(4), v, w),
    "turned by 90 deg": lambda p, q, v, w: (p, np.roll(q, 1), v, w),
    "velocity off by 0.5 m/s": lambda p, q, v, w: (p, q, v + 0.5, w),
}


@pytest.mark.parametrize("damage", BAD.values(), ids=BAD.keys())
def test_a_bad_reading_is_rejected_and_replaced_by_the_prediction(damage):
    motion = Walk()
    messages = clean(motion, 1.0)
    index = [i for i, m in enumerate(messages) if m[0] == "odometry"][20]
    kind, stamp, values = messages[index]
    messages[index] = (kind, stamp, damage(*values))
    estimates, _ = run(messages)
    expected = [Validity.ODOMETRY_REJECTED if i == 20 else Validity.VALID for i in range(15, 30)]
    assert validities(estimates[15:]) == expected
    # one step with the IMU only, then as before
    assert max(np.abs(error(e, motion)[3:6]).max() for e in estimates) < 2e-4


def test_bad_imu_samples_have_no_effect():
    messages = noisy(Walk(), 1.0, 4)
    rng = np.random.default_rng(0)
    bad = [np.full(3, np.nan), np.array([0, np.inf, 0]), np.full(3, 1e6), np.zeros(4)]
    keep, damaged = [], []
    for kind, stamp, values in messages:
        drop = kind == "imu" and rng.random() < 0.2
        keep += [] if drop else [(kind, stamp, values)]
        values = (values[0], bad[rng.integers(4)]) if drop else values  # noqa: PLW2901
        damaged.append((kind, stamp, values))
    assert len(keep) < len(messages)
    assert same(run(damaged)[0], run(keep)[0])


def test_missing_imu_is_flagged_and_estimates_continue_from_the_odometry():
    motion = Walk()
    dead = [m for m in noisy(motion, 2.0, 6) if m[0] == "odometry" or not 0.7 < m[1] / SECOND < 1.4]
    estimates, _ = run(dead, MATCHED)
    for e in estimates[15:]:
        t = e.stamp / SECOND
        blind = 0.7 + SETTINGS.timing.imu_gap < t <= 1.4
        assert e.validity == (Validity.IMU_MISSING if blind else Validity.VALID), t
        # 540 numbers: 5 sigma have a probability of 3e-4; without the IMU the error is no larger
        assert np.all(np.abs(error(e, motion)) < 5 * np.sqrt(np.diag(e.covariance))), t


def test_without_any_imu_estimates_come_one_reading_late():
    readings = odometry_messages(Walk(), 1.0)
    estimates, _ = run(readings)
    assert [e.stamp for e in estimates] == [m[1] for m in readings[:-1]]
    n = SETTINGS.gate.initial_readings
    assert set(validities(estimates[n:])) == {Validity.IMU_MISSING}


def test_after_a_long_gap_in_the_odometry_the_filter_restarts_and_keeps_the_bias():
    motion = Walk()
    messages = noisy(motion, 12.0, 7, GYRO_BIAS)
    messages = [m for m in messages if m[0] == "imu" or not 9 < m[1] / SECOND < 11]
    estimates, estimator = run(messages, MATCHED)
    after = [e for e in estimates if e.stamp / SECOND > 10]
    n = SETTINGS.gate.initial_readings
    assert validities(after)[: n + 1] == [Validity.INITIALISING] * (n - 1) + [Validity.VALID] * 2
    np.testing.assert_allclose(estimator.gyro_bias, GYRO_BIAS, atol=1.2e-3)


def test_a_clock_set_back_gives_the_estimates_of_a_new_estimator():
    first, second = noisy(Walk(), 3.0, 8, GYRO_BIAS), noisy(Walk(), 1.0, 9)
    estimates, _ = run(first + second)
    fresh, _ = run(second)
    assert same(estimates[-len(fresh) :], fresh)


def test_repeated_and_older_stamps_are_ignored():
    messages = noisy(Walk(), 1.0, 10)
    double = [m for i, m in enumerate(messages) for m in (m, messages[max(i - 9, 0)], m)]
    assert same(run(double)[0], run(messages)[0])


def test_arbitrary_data_never_raises_and_never_gives_nan():
    rng = np.random.default_rng(11)
    odd = [np.nan, np.inf, -np.inf, 0.0, 1.0, -1.0, 1e-300, 1e300, 30.0, 9.81]
    estimator, stamp, count = StateEstimator(SETTINGS), 0, 0
    for _ in range(4000):
        stamp += int(rng.choice([0, 1, 5_000_000, 33_000_000, 10**9, -(10**7), -(10**10)]))
        w, f, p, v = (rng.choice(odd[3 if rng.random() < 0.9 else 0 :], 3) for _ in range(4))
        estimator.add_imu(stamp, w, f)
        estimator.add_odometry(stamp - int(rng.integers(2)), p, [0.6, 0, 0, 0.8], v, w)
        while (estimate := estimator.poll()) is not None:
            count += 1
            assert np.all(np.isfinite(estimate.state))
            assert np.all(np.isfinite(estimate.covariance))
    assert count > 100


def test_unpolled_and_unmatched_data_stay_within_the_buffers():
    small = dataclasses.replace(SETTINGS.buffers, imu=20, odometry=3, estimates=5)
    estimator = StateEstimator(dataclasses.replace(SETTINGS, buffers=small))
    reading = odometry_messages(Walk(), 0.1)[0][2]
    for k in range(1000):
        estimator.add_imu(k, [0, 0, 0], [0, 0, GRAVITY])
    for k in range(1000, 2000):  # 1 ns apart: no wait is over, only the full queue decides
        estimator.add_odometry(k, *reading)
    assert [e.stamp for e in iter(estimator.poll, None)] == list(range(1992, 1997))
