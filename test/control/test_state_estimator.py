"""State estimator: closed-form motion, chi-square statistics, order of arrival, validity.

Messages are matched by their stamp.
"""

import dataclasses
import itertools

import numpy as np
import pytest
from estimator_streams import (
    FORCE_NOISE,
    GYRO_BIAS,
    GYRO_NOISE,
    SETTINGS,
    Walk,
    arrivals,
    arriving,
    changed,
    imu_messages,
    noisy,
    odometry_messages,
    run,
    same,
    validities,
    without,
)
from scipy import stats
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.clock import SECOND
from slot_core.estimation.estimate import Validity
from slot_core.estimation.sensor_agreement import STRAYS
from slot_core.estimation.state_estimator import StateEstimator
from slot_core.geometry import wrapped
from slot_core.key_frame import capture
from slot_core.robot import GRAVITY
from slot_nodes.inputs import TimeSynchronizer

PERIOD = SETTINGS.timing.period  # s
UNTIL_VALID = 13  # ticks: 0.3 s, and two readings more after a rejection

MATCHED = config.replace(
    SETTINGS,
    {
        "imu.gyro_noise": GYRO_NOISE / 200**0.5,
        "imu.acceleration_noise": FORCE_NOISE / 200**0.5,
        "imu.acceleration_bias": 0.1,
        "imu.angular_acceleration_step": 1.0,  # of the sinusoids: 0.22 rad (2 pi / 0.7 s)^3 5 ms
    },
)
EXACT = config.replace(
    SETTINGS, {"imu.gyro_bias": 0.0, "imu.acceleration_bias": 0.0}
)


def error(estimate, motion):
    """Estimate minus truth (12,), angles wrapped."""
    difference = estimate.state - motion.at(estimate.time / SECOND)[0]
    difference[:3] = wrapped(difference[:3])
    return difference


def clean(motion, duration):
    return arrivals(
        imu_messages(motion, duration), odometry_messages(motion, duration)
    )


def with_jump(messages, readings, shift):
    """The messages with odometry positions shifted by `shift` m."""
    return changed(messages, readings, lambda p, *rest: (p + shift, *rest))


# --- accuracy ---


def test_dead_reckoning_error_falls_with_the_square_of_the_imu_interval():
    """One reading, then only the IMU for 0.4 s: the midpoint rule is of second order."""
    motion, errors = Walk(), []
    first = odometry_messages(motion, 0.1)[:1]
    for rate in (200, 400, 800):
        _, estimator = run(
            arrivals(imu_messages(motion, 0.4, rate), first), EXACT
        )
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
            nees.append(
                e @ np.linalg.solve(estimate.covariance[states, states], e)
            )
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
        # -q is the same attitude
        estimator.add_odometry(0, p, -attitude.as_quat(), v, w)
        estimator.add_imu(0, w, [0.0, 0.0, GRAVITY])
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


# --- ticks ---

LATE = 0.01  # s, jitter of odometry that comes late


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("rate", [5, 8, 15, 60, 200])
def test_odometry_of_any_rate_and_delay_gives_consistent_estimates_at_the_ticks(
    rate, delay
):
    motion, rng = Walk(), np.random.default_rng(3)
    messages = arrivals(
        imu_messages(motion, 4.0, rng=rng, bias=GYRO_BIAS),
        odometry_messages(motion, 4.0, rate, rng=rng),
    )
    late = arriving(
        messages, lambda: delay + (delay > 0.0) * rng.uniform(-LATE, LATE)
    )
    estimates, _ = run(late, MATCHED)
    first = delay / PERIOD + 2
    assert (4.0 / PERIOD) - first < len(estimates) <= 4.0 / PERIOD + 1
    assert set(np.diff([e.stamp for e in estimates])) == {PERIOD * SECOND}
    after = estimates[round(1.0 / PERIOD) :]
    assert set(validities(after)) == {Validity.VALID}
    errors = np.array([error(e, motion) for e in after])
    sigma = np.sqrt([np.diagonal(e.covariance) for e in after])
    # some 1000 numbers: 5 sigma have a probability of 6e-4
    assert np.all(np.abs(errors) < 5 * sigma)
    # 0.4 s after a reading: 0.3 m/s^2 sqrt(5 ms) 0.4^1.5 s^1.5 / sqrt(3)
    assert np.abs(errors[:, 3:6]).max() < 0.01


@pytest.mark.parametrize("first", ["imu", "odometry"])
def test_the_first_tick_needs_no_more_than_a_reading_and_a_sample(first):
    messages = sorted(clean(Walk(), 0.04)[:2], key=lambda m: m[0] != first)
    assert [e.stamp for e in run(messages)[0]] == [0]


BLIND = {20: 50, 25: 40, 30: 100 / 3, 60: 100 / 3, 200: 35}


@pytest.mark.parametrize("rate", BLIND)
def test_without_an_imu_the_reading_nearest_to_a_tick_gives_the_estimate(rate):
    motion, rng = Walk(), np.random.default_rng(3)
    estimates, _ = run(odometry_messages(motion, 4.0, rate, rng=rng), MATCHED)
    apart = np.diff([e.stamp for e in estimates]) / 1e6
    np.testing.assert_allclose(apart, BLIND[rate], atol=1e-5)  # ms
    after = estimates[round(1.0 / PERIOD) :]
    assert set(validities(after)) == {Validity.IMU_MISSING}
    errors = np.array([error(e, motion) for e in after])
    sigma = np.sqrt([np.diagonal(e.covariance) for e in after])
    assert np.all(np.abs(errors) < 5 * sigma)


def test_an_imu_that_dies_gives_the_clock_to_the_odometry_and_takes_it_back():
    motion = Walk()
    estimates, _ = run(without("imu", noisy(motion, 4.0, 3), 2.0, 3.0), MATCHED)
    times = np.array([e.time for e in estimates]) / SECOND
    apart = np.diff(times)
    lost = SETTINGS.timing.imu_lost
    # the sample before, and the odometry that finds it missing
    assert apart.max() < PERIOD + lost + 1 / 30
    dead = (times > 2.0 + lost) & (times < 3.0)
    assert sum(apart > 1.3 * PERIOD) == 1
    found = np.array(validities(estimates))
    assert set(found[dead]) == {Validity.IMU_MISSING}
    assert set(found[(times > 1.0) & (times <= 2.0)]) == {Validity.VALID}
    assert set(found[times > 3.0 + 2 * PERIOD]) == {Validity.VALID}
    for e in estimates[UNTIL_VALID:]:
        sigma = np.sqrt(np.diag(e.covariance))
        assert np.all(np.abs(error(e, motion)) < 5 * sigma)


SLOW = {
    "odom at 3.5 Hz, limit 4 Hz with an IMU": (3.5, True),
    "odom at 15.0 Hz, limit 16 Hz without an IMU": (15, False),
    "no usable odom for 0.": (1, True),
}


@pytest.mark.parametrize("line", SLOW)
def test_odometry_below_the_least_rate_is_refused_in_a_line(line):
    rate, with_imu = SLOW[line]
    messages = odometry_messages(Walk(), 6.0, rate)
    if with_imu:
        messages = arrivals(imu_messages(Walk(), 6.0), messages)
    estimates, _ = run(messages)
    last = [e for e in estimates[-30:] if e.message.startswith(line)]
    assert last[-1].validity in {Validity.ODOMETRY_SLOW, Validity.ODOMETRY_LOST}
    usable = {Validity.VALID, Validity.IMU_MISSING}
    assert usable.isdisjoint(validities(estimates))


@pytest.mark.parametrize(("rate", "with_imu"), [(5, True), (20, False)])
def test_a_reading_may_be_lost_at_the_least_rate(rate, with_imu):
    messages = odometry_messages(Walk(), 6.0, rate)
    messages = without("odometry", messages, 3.5 / rate + 3.0, 4.5 / rate + 3.0)
    if with_imu:
        messages = arrivals(imu_messages(Walk(), 6.0), messages)
    assert len(set(validities(run(messages)[0][round(1.0 / PERIOD) :]))) == 1


# --- order of arrival ---


@pytest.mark.parametrize("seed", range(5))
def test_the_filter_does_not_depend_on_the_interleaving_of_the_streams(seed):
    """The odometry comes up to 36 ms before or after the IMU; its readings keep their order.

    Estimates that have seen the same readings are equal to the last bit, and so are those at the
    end.
    """
    messages, rng = (
        [
            m
            for m in noisy(Walk(), 2.2, 3, GYRO_BIAS)
            if m[0] == "imu" or m[1] < 2 * SECOND
        ],
        np.random.default_rng(seed),
    )
    shift = rng.uniform(-0.02, 0.02)
    shuffled = arriving(messages, lambda: shift + rng.uniform(-0.016, 0.016))
    (expected, _), (estimates, _) = run(messages), run(shuffled)
    stamps = [[e.stamp for e in found] for found in (expected, estimates)]
    assert set(stamps[1]) >= set(stamps[0][2:])
    assert (
        sum(same([a], [b]) for a, b in zip(estimates[-50:], expected[-50:])) > 5
    )
    assert same(estimates[-2:], expected[-2:])


# --- delay and loss of the odometry ---


def rms_at_use(estimates, motion):
    """RMS error of angles, position, angular velocity and velocity at the estimates' times."""
    errors = np.array([error(e, motion) for e in estimates])
    return np.sqrt(np.mean(errors**2, axis=0)).reshape(4, 3).mean(axis=1)


def test_a_loss_of_odometry_is_flagged_in_time_and_the_imu_carries_on_for_a_second():
    motion, wait = Walk(), SETTINGS.timing.odometry_wait
    lost = without("odometry", noisy(motion, 8.0, 3, GYRO_BIAS), 5.0, 6.0)
    estimates, _ = run(lost, MATCHED)
    apart = np.diff([e.stamp for e in estimates]) / SECOND
    np.testing.assert_allclose(apart, PERIOD, atol=1e-8)
    flagged = [e for e in estimates if e.validity == Validity.ODOMETRY_LOST]
    assert 0.0 < flagged[0].stamp / SECOND - 5.0 - wait <= PERIOD
    assert flagged[-1].message == "no usable odom for 0.97 s, limit 0.5 s"
    in_gap = [e for e in estimates if 5.0 < e.stamp / SECOND < 6.0]
    worst = np.abs([error(e, motion) for e in in_gap]).max(axis=0)
    # four standard deviations after 1 s: 0.3 m/s^2 sqrt(5 ms) = 0.021 m/s, its integral 0.012 m
    assert worst[3:6].max() < 0.05
    assert worst[9:12].max() < 0.085
    assert set(
        validities([e for e in estimates[UNTIL_VALID:] if e not in flagged])
    ) == {Validity.VALID}


def test_after_a_long_gap_in_the_odometry_the_filter_restarts_and_keeps_the_bias():
    """Meanwhile the ticks go on, with a state that stands still: an estimator never ends."""
    messages = without("odometry", noisy(Walk(), 12.0, 7, GYRO_BIAS), 9.0, 11.0)
    before = [m for m in messages if m[1] < 10.9 * SECOND]
    estimates, estimator = run(before, MATCHED)
    still = [e for e in estimates if e.stamp > 10.2 * SECOND]
    assert len(still) > 20
    assert set(validities(still)) == {Validity.ODOMETRY_LOST}
    assert len({e.time for e in still}) == 1
    assert estimator.present() is None
    after, _ = run(messages[len(before) :], MATCHED, estimator)
    assert after[0].stamp - estimates[-1].stamp == PERIOD * SECOND
    found = validities(after[4:])  # from 11 s on
    assert set(found[:7]) == {Validity.INITIALISING}
    assert set(found[UNTIL_VALID:]) == {Validity.VALID}
    np.testing.assert_allclose(estimator.gyro_bias, GYRO_BIAS, atol=1.2e-3)


def test_the_stamps_of_the_estimates_increase_whatever_arrives():
    rng = np.random.default_rng(2)
    kept = [
        m
        for m in noisy(Walk(), 20.0, 3)
        if m[0] == "imu" or rng.random() < 0.15
    ]
    estimates, _ = run(arriving(kept, lambda: rng.uniform(0.0, 0.3)))
    assert min(np.diff([e.stamp for e in estimates])) > 0
    assert min(np.diff([e.time for e in estimates])) >= 0
    assert {Validity.VALID, Validity.ODOMETRY_LOST} <= set(
        validities(estimates)
    )


def test_the_state_is_predicted_beyond_the_newest_sample_by_the_delay_of_the_command():
    motion = Walk()
    settings = config.replace(SETTINGS, {"timing.command_delay": 0.01})
    messages = clean(motion, 2.0)
    ahead, now = (run(messages, s)[0][20:] for s in (settings, SETTINGS))
    assert {a.time - b.time for a, b in zip(ahead, now)} == {10_000_000}
    # angle, position, rate, velocity: third derivatives by the square of 10 ms
    assert np.all(rms_at_use(ahead, motion) < [2e-3, 1e-4, 0.2, 5e-3])
    held = [dataclasses.replace(b, lead=a.lead) for a, b in zip(ahead, now)]
    assert rms_at_use(held, motion)[0] > 2 * rms_at_use(ahead, motion)[0]


def test_the_present_state_follows_every_imu_sample():
    motion, estimator = Walk(), StateEstimator(SETTINGS)
    assert estimator.present() is None
    for message in clean(motion, 2.0):
        run([message], estimator=estimator)
        if message[0] == "imu" and message[1] > 0.5 * SECOND:
            present = estimator.present()
            assert (present.time, present.validity) == (
                message[1],
                Validity.VALID,
            )
            assert np.abs(error(present, motion)[3:6]).max() < 2e-4


def test_an_imu_mounted_elsewhere_gives_the_same_estimates():
    """Turned by 90 deg, 0.1 m off the centre; the rotation is constant: no angular acceleration."""
    motion, r = Walk(turn=1.7), np.array([0.1, -0.05, 0.03])
    motion.amplitude[:3] = 0.0
    motion.offset[:2] = 0.5, -0.6
    messages = clean(motion, 2.0)
    rpy = 0.0, 0.3, np.pi / 2
    turn = Rotation.from_euler("xyz", rpy).inv()
    mounted = [
        (
            kind,
            stamp,
            turn.apply([v[0], v[1] + np.cross(v[0], np.cross(v[0], r))]),
        )
        if kind == "imu"
        else (kind, stamp, v)
        for kind, stamp, v in messages
    ]
    mount = {"mounts.imu.position": tuple(r), "mounts.imu.rpy": rpy}
    found, _ = run(mounted, config.replace(SETTINGS, mount))
    for estimate, expected in zip(found, run(messages)[0], strict=True):
        np.testing.assert_allclose(estimate.state, expected.state, atol=1e-9)


# --- noise of a reading ---


def test_a_reading_has_its_own_variance_unless_it_is_unknown():
    messages, jump = noisy(Walk(), 1.0, 3), slice(20, 21)
    plain = run(messages)[0]
    for unknown in (0.0, np.nan):
        given = changed(messages, jump, lambda *v: (*v, np.full(12, unknown)))  # noqa: B023
        assert same(run(given)[0], plain)
    # an uncertain reading has no weight and is no outlier
    off = with_jump(clean(Walk(), 1.0), jump, np.array([0.1, 0.0, 0.0]))
    estimates, _ = run(changed(off, jump, lambda *v: (*v, np.full(12, np.inf))))
    assert set(validities(estimates[15:])) == {Validity.VALID}
    assert max(np.abs(error(e, Walk())[3:6]).max() for e in estimates) < 2e-4


# --- validity ---


def test_a_rejection_while_initialising_restarts_the_count():
    estimates, _ = run(with_jump(clean(Walk(), 1.0), slice(6, 7), 0.1))
    since = 7 / 30 + SETTINGS.gate.initial_time
    early = [e for e in estimates if e.stamp < since * SECOND]
    assert set(validities(early)) == {Validity.INITIALISING}
    assert set(validities(estimates[len(early) :])) == {Validity.VALID}


def test_odometry_that_has_jumped_is_accepted_after_some_rejections_and_the_estimates_go_on():
    """A SLAM that starts anew: the torso moves on as the IMU says, in another frame."""
    motion, shift = Walk(), [0.3, -0.2, 0.1]
    begun = 1.0 + (SETTINGS.gate.max_rejections - 1) / 30
    messages = with_jump(clean(motion, 2.0), slice(30, None), shift)
    estimates, _ = run(messages)
    offsets = np.array([error(e, motion)[3:6] for e in estimates])
    times = np.array([e.stamp for e in estimates]) / SECOND
    assert set(np.array(validities(estimates))[times > 0.4]) == {Validity.VALID}
    assert np.abs(offsets[(times > 0.1) & (times < begun)]).max() < 2e-4
    assert np.abs(offsets[times > begun + 0.05] - shift).max() < 2e-4
    messages = with_jump(
        noisy(motion, 12.0, 7, GYRO_BIAS), slice(300, None), shift
    )
    until = [m for m in messages if m[1] < 10.5 * SECOND]
    np.testing.assert_allclose(
        run(until, MATCHED)[1].gyro_bias, GYRO_BIAS, atol=1.2e-3
    )


def test_odometry_of_another_motion_restarts_the_filter_without_its_biases():
    """They may be what was wrong."""
    motion, rejected = Walk(), SETTINGS.gate.max_rejections - 1
    other = lambda p, q, v, w: (p + 0.3, q, v + 0.2, w)  # noqa: E731
    messages = changed(
        noisy(motion, 12.0, 7, GYRO_BIAS), slice(300, None), other
    )
    estimates, _ = run(messages, MATCHED)
    begun = 10.0 + rejected / 30 - 0.001
    times = np.array([e.stamp for e in estimates]) / SECOND
    found = np.array(validities(estimates))
    assert set(found[(times > 0.4) & (times < begun)]) == {Validity.VALID}
    initial = (times > begun + 0.005) & (times < begun + 0.3)
    assert set(found[initial]) == {Validity.INITIALISING}
    for reading, bias in ((300, GYRO_BIAS), (300 + rejected, 0.0)):
        until = [m for m in messages if m[1] < (reading + 0.5) / 30 * SECOND]
        np.testing.assert_allclose(
            run(until, MATCHED)[1].gyro_bias, bias, atol=1.2e-3
        )


@pytest.mark.parametrize(
    ("rate", "serves"), [(200, True), (50, True), (25, False)]
)
def test_an_imu_below_the_least_rate_is_as_none_and_a_line_says_so(
    rate, serves
):
    messages = [
        m
        for m in noisy(Walk(), 2.0, 4)
        if m[0] != "imu" or round(m[1] / SECOND * 200) % (200 // rate) == 0
    ]
    late = [e for e in run(messages)[0] if e.stamp > SECOND]
    assert {e.validity is Validity.IMU_MISSING for e in late} == {not serves}
    line = "imu at 25 Hz, limit 40 Hz: it is not used"
    assert {e.message == line for e in late} == {not serves}


def test_readings_that_alternate_between_two_positions_are_not_accepted():
    messages = clean(Walk(), 2.5)
    for start, shift in ((20, 0.2), (21, -0.2)):
        messages = with_jump(
            messages, slice(start, None, 2), np.array([shift, 0, 0])
        )
    estimates, timing = run(messages)[0], SETTINGS.timing
    times = np.array([e.stamp for e in estimates]) / SECOND - (19 / 30)
    late = estimates[np.flatnonzero(times > timing.odometry_wait)[0] :]
    rejected = [
        e for e, t in zip(late, times[-len(late) :]) if t < timing.odometry_gap
    ]
    assert set(validities(rejected)) == {Validity.ODOMETRY_REJECTED}
    assert rejected[0].message.startswith("odom contradicts the IMU for 0.5")
    assert Validity.VALID not in validities(late)
    coasting = estimates[round(0.5 / PERIOD) : -len(late)]
    assert max(np.abs(error(e, Walk())[3:6]).max() for e in coasting) < 2e-4


BAD = {
    "nan position": lambda p, q, v, w: (p * np.nan, q, v, w),
    "inf velocity": lambda p, q, v, w: (p, q, v + np.inf, w),
    "nan rate": lambda p, q, v, w: (p, q, v, w * np.nan),
    "huge position": lambda p, q, v, w: (p + 1e300, q, v, w),
    "zero quaternion": lambda p, q, v, w: (p, q * 0, v, w),
    "quaternion of norm 1.1": lambda p, q, v, w: (p, q * 1.1, v, w),
    "position off by 0.1 m": lambda p, q, v, w: (p + 0.1, q, v, w),
    "short position": lambda p, q, v, w: (p[:2], q, v, w),
    "quaternion as matrix": lambda p, q, v, w: (p, np.eye(4), v, w),
    "turned by 90 deg": lambda p, q, v, w: (p, np.roll(q, 1), v, w),
    "velocity off by 0.5 m/s": lambda p, q, v, w: (p, q, v + 0.5, w),
}


@pytest.mark.parametrize("damage", BAD.values(), ids=BAD.keys())
def test_a_bad_reading_is_rejected_and_replaced_by_the_prediction(damage):
    motion = Walk()
    estimates, _ = run(changed(clean(motion, 1.0), slice(20, 21), damage))
    plain, _ = run(clean(motion, 1.0))
    assert set(validities(estimates[UNTIL_VALID:])) == {Validity.VALID}
    apart = [
        (a.covariance[3, 3] - b.covariance[3, 3]) / b.covariance[3, 3]
        for a, b in zip(estimates, plain, strict=True)
    ]
    # the tick after reading 20, 0.667 s
    assert apart[20] == 0.0 < apart[21]
    # one step with the IMU only, then as before
    assert max(np.abs(error(e, motion)[3:6]).max() for e in estimates) < 2e-4


def test_bad_imu_samples_and_repeated_and_older_stamps_have_no_effect():
    messages, more = noisy(Walk(), 1.0, 4), []
    bad = itertools.cycle([[np.nan] * 3, [0, np.inf, 0], [1e6] * 3, [0.0] * 4])
    for i, message in enumerate(messages):
        sample = ("imu", message[1] + 1, (np.zeros(3), next(bad)))
        more += [message, messages[max(i - 9, 0)], message, sample]
    assert same(run(more)[0], run(messages)[0])


def test_after_a_loss_of_both_sensors_the_estimate_is_as_uncertain_as_it_is():
    """60 ms without either, then the IMU again: a part of a swing is missed."""
    motion = Walk()
    dead = [
        m for m in noisy(motion, 1.1, 3) if not SECOND < m[1] <= 1.06 * SECOND
    ]
    present = run(
        [m for m in dead if m[0] == "imu" or m[1] <= SECOND], MATCHED
    )[1].present()
    sigma = np.sqrt(np.diag(present.covariance))
    assert np.all(np.abs(error(present, motion)) < 5 * sigma)


@pytest.mark.parametrize("false", [6.0, -6.0])
def test_a_filter_that_a_false_force_has_led_astray_is_valid_again_within_a_second(
    false,
):
    """As of a robot that is stopped in mid-bounce: it reports an acceleration and no motion."""
    messages = noisy(Walk(), 5.0, 3)
    for kind, stamp, values in messages:
        if kind == "imu" and stamp < SECOND / 3:
            values[1][2] += false
    after = [e for e in run(messages)[0] if e.stamp > 1.4 * SECOND]
    assert set(validities(after)) == {Validity.VALID}


def test_estimates_stay_valid_in_a_turn_on_an_incline():
    """The tilt of odom is constant in odom; seen from base_link it turns."""
    motion = Walk(speed=0.0, turn=0.1, incline=np.radians(10.0))
    after = [
        e for e in run(noisy(motion, 30.0, 4))[0] if e.stamp > 3.0 * SECOND
    ]
    assert set(validities(after)) == {Validity.VALID}


def test_gravity_is_that_of_a_walk_on_an_incline_and_straight_down_without_an_imu():
    """In the frame of the estimates, within .7 deg: tilts of 13 deg at 1.4 Hz leave .4."""
    motion = Walk(incline=np.radians(5.0), turn=0.1)
    estimates, _ = run(without("imu", noisy(motion, 9.0, 6), 6.0, 9.0))
    for e in estimates:
        if 2.0 * SECOND < e.stamp < 5.9 * SECOND:
            angle = np.cross(e.gravity, motion.up) / GRAVITY**2
            assert np.linalg.norm(angle) < np.radians(0.7)
            assert np.linalg.norm(e.gravity) == pytest.approx(GRAVITY)
    np.testing.assert_array_equal(estimates[-1].gravity, [0, 0, -GRAVITY])


def test_a_clock_set_back_gives_the_estimates_of_a_new_estimator():
    first, second = noisy(Walk(), 3.0, 8, GYRO_BIAS), noisy(Walk(), 1.0, 9)
    fresh, _ = run(second[STRAYS:])  # one odometry reading among them
    assert same(run(first + second)[0][-len(fresh) :], fresh)


def test_arbitrary_data_never_raises_and_never_gives_nan():
    rng = np.random.default_rng(11)
    odd = [np.nan, np.inf, -np.inf, 0.0, 1.0, -1.0, 1e-300, 1e300, 30.0, 9.81]
    steps = [0, 1, 5_000_000, 33_000_000, 10**9, -(10**7), -(10**10)]
    messages, stamp = [], 0
    for _ in range(4000):
        stamp += int(rng.choice(steps))
        w, f, p, v = rng.choice(odd[3 if rng.random() < 0.9 else 0 :], (4, 3))
        messages.append(("imu", stamp, (w, f)))
        earlier = stamp - int(rng.integers(2))
        messages.append(("odometry", earlier, (p, [0.6, 0, 0, 0.8], v, w)))
    estimates, _ = run(messages)
    assert len(estimates) > 100
    assert all(
        np.isfinite([*e.state, *e.covariance.flat]).all() for e in estimates
    )


def test_unpolled_and_unmatched_data_stay_within_the_buffers():
    small = dataclasses.replace(
        SETTINGS.buffers, imu=20, odometry=3, estimates=5
    )
    estimator = StateEstimator(dataclasses.replace(SETTINGS, buffers=small))
    reading = odometry_messages(Walk(), 0.1)[0][2]
    for k in range(1000):
        estimator.add_imu(k, [0, 0, 0], [0, 0, GRAVITY])
    # 1 ns apart: the IMU is not lost, only the full queue decides
    sizes = []
    for k in range(1000, 2000):
        estimator.add_odometry(k, *reading)
        sizes.append(len(capture(estimator)))
    assert max(sizes[100:]) < 1.1 * max(sizes[:100])
    ticks = [1000 + k * round(PERIOD * SECOND) for k in range(100)]
    for stamp in ticks:
        for later in (1000, round(PERIOD / 2 * SECOND)):
            estimator.add_imu(stamp + later, [0, 0, 0], [0, 0, GRAVITY])
    assert [e.stamp for e in iter(estimator.poll, None)] == ticks[-5:]


OLD = [("b", stamp) for stamp in range(100, 110)]
# messages by topic and stamp, and which of them complete a set
SETS = {
    "in any order": ([("b", 7), ("a", 8), ("a", 7)], [2]),
    "once": ([("a", 1), ("b", 1), ("b", 1)], [1]),
    "a lost one costs its own set alone": (
        [*OLD, ("a", 100), ("a", 109)],
        [11],
    ),
    "a clock set back delays nothing": ([*OLD, ("a", 1), ("b", 1)], [11]),
}


@pytest.mark.parametrize("case", SETS)
def test_a_set_is_returned_when_it_is_complete(case):
    messages, complete = SETS[case]
    synchronizer = TimeSynchronizer("a", "b", depth=3)
    for number, (topic, stamp) in enumerate(messages):
        found = synchronizer.add(topic, stamp, f"{topic}{stamp}")
        expected = (f"a{stamp}", f"b{stamp}") if number in complete else None
        assert found == expected
