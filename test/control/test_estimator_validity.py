"""State estimator with late, lost, uncertain and bad data: what it says of its estimates."""

import dataclasses

import numpy as np
import pytest
from estimator_streams import (
    GYRO_BIAS,
    MATCHED,
    SETTINGS,
    Spin,
    Walk,
    arriving,
    clean,
    error,
    noisy,
    odometry_messages,
    run,
    same,
    validities,
    with_jump,
)
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.clock import SECOND
from slot_core.estimation.estimate import Validity
from slot_core.estimation.state_estimator import StateEstimator
from slot_core.robot import GRAVITY

# --- delay and loss of the odometry ---


def rms_at_use(estimates, motion):
    """RMS error of angles, position, angular velocity and velocity at the estimates' times."""
    errors = np.array([error(e, motion) for e in estimates])
    return np.sqrt(np.mean(errors**2, axis=0)).reshape(4, 3).mean(axis=1)


def test_a_delay_of_the_odometry_with_jitter_costs_only_what_the_imu_drifts():
    """80 ms +- 20 ms: the state at the newest sample, beside that without any delay."""
    motion, rng = Walk(), np.random.default_rng(1)
    messages = noisy(motion, 10.0, 1, GYRO_BIAS)
    late = arriving(
        messages, lambda kind: rng.uniform(0.06, 0.1) if kind == "odometry" else 0.0
    )
    prompt, delayed = run(messages, MATCHED)[0][30:], run(late, MATCHED)[0][30:]
    leads = (
        np.array([e.lead for e in delayed[:-4]]) / SECOND
    )  # the IMU ends with the odometry
    assert leads.min() > 0.055
    assert leads.max() < 0.105
    # of velocity: 0.3 m/s^2 sqrt(5 ms) sqrt(80 ms) = 6 mm/s more, in quadrature
    rms, without = rms_at_use(delayed, motion), rms_at_use(prompt, motion)
    assert np.all(rms < np.hypot(without, [2e-3, 5e-4, 0.0, 6e-3]) * 1.1), (
        rms,
        without,
    )


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
    np.testing.assert_allclose(
        np.diff([e.stamp for e in flagged]) / SECOND, period, atol=1e-8
    )
    worst = np.abs([error(e, motion) for e in flagged]).max(axis=0)
    # four standard deviations after 1 s: 0.3 m/s^2 sqrt(5 ms) = 0.021 m/s, its integral 0.012 m
    assert worst[3:6].max() < 0.05
    assert worst[9:12].max() < 0.085
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
    late = arriving(
        kept, lambda kind: rng.uniform(0.0, 0.3) if kind == "odometry" else 0.0
    )
    estimates, _ = run(late)
    assert min(np.diff([e.stamp for e in estimates])) > 0
    assert min(np.diff([e.time for e in estimates])) >= 0
    assert {Validity.VALID, Validity.ODOMETRY_LOST} <= set(validities(estimates))


def test_the_state_is_predicted_beyond_the_newest_sample_by_the_delay_of_the_command():
    motion = Walk()
    settings = config.replace(SETTINGS, {"timing.command_delay": 0.01})
    ahead, now = (
        run(clean(motion, 2.0), settings)[0][20:],
        run(clean(motion, 2.0))[0][20:],
    )
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
    kept = [
        m
        for m in noisy(motion, 1.1, 3)
        if m[1] <= SECOND or (m[0] == "imu" and m[1] > 1.06e9)
    ]
    _, estimator = run(kept, MATCHED)
    present = estimator.present()
    assert np.all(
        np.abs(error(present, motion)) < 5 * np.sqrt(np.diag(present.covariance))
    )


# --- noise of a reading ---


def with_variance(messages, variance, index):
    """The messages with the variance (12,) of one odometry reading."""
    place = [i for i, m in enumerate(messages) if m[0] == "odometry"][index]
    kind, stamp, values = messages[place]
    return [
        *messages[:place],
        (kind, stamp, (*values, variance)),
        *messages[place + 1 :],
    ]


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


# --- validity ---


def test_a_rejection_while_initialising_restarts_the_count():
    n = SETTINGS.gate.initial_readings
    found = validities(run(with_jump(clean(Walk(), 1.0), n - 2, 0.1, n - 1))[0])
    assert found[: n - 2] == [Validity.INITIALISING] * (n - 2)
    assert found[n - 2] == Validity.ODOMETRY_REJECTED
    assert found[n - 1 : 2 * n - 2] == [Validity.INITIALISING] * (n - 1)
    assert set(found[2 * n - 2 :]) == {Validity.VALID}


def test_a_single_jump_is_rejected_and_does_not_affect_the_position():
    motion, shift = Walk(), np.array([0.1, 0.0, 0.0])
    estimates, _ = run(with_jump(clean(motion, 1.0), 15, shift, 16))
    assert [
        i
        for i, v in enumerate(validities(estimates))
        if v == Validity.ODOMETRY_REJECTED
    ] == [15]
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
    expected = [
        Validity.ODOMETRY_REJECTED if i == 20 else Validity.VALID for i in range(15, 30)
    ]
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
    dead = [
        m
        for m in noisy(motion, 2.0, 6)
        if m[0] == "odometry" or not 0.7 < m[1] / SECOND < 1.4
    ]
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
    assert (
        validities(after)[: n + 1]
        == [Validity.INITIALISING] * (n - 1) + [Validity.VALID] * 2
    )
    np.testing.assert_allclose(estimator.gyro_bias, GYRO_BIAS, atol=1.2e-3)


def test_a_restart_after_rejected_readings_forgets_the_bias():
    """It may be what was wrong."""
    first, shift = 300, np.array([0.3, -0.2, 0.1])
    messages = with_jump(noisy(Walk(), 12.0, 7, GYRO_BIAS), first, shift)
    stamps = [stamp for kind, stamp, _ in messages if kind == "odometry"]
    for reading, bias in (
        (first, GYRO_BIAS),
        (first + SETTINGS.gate.max_rejections - 1, 0.0),
    ):
        until = [m for m in messages if m[1] < stamps[reading] + SECOND / 60]
        np.testing.assert_allclose(run(until, MATCHED)[1].gyro_bias, bias, atol=1.2e-3)


@pytest.mark.parametrize("false", [6.0, -6.0])
def test_a_filter_that_a_false_force_has_led_astray_is_valid_again_within_a_second(
    false,
):
    """As of a robot that is stopped in mid-bounce: it reports an acceleration and no motion."""
    motion = Walk()
    messages = []
    for kind, stamp, values in noisy(motion, 5.0, 3):
        if kind == "imu" and stamp < SECOND / 3:
            values = values[0], values[1] + [0, 0, false]  # noqa: PLW2901
        messages.append((kind, stamp, values))
    after = [e for e in run(messages, SETTINGS)[0] if e.stamp > 1.4 * SECOND]
    assert set(validities(after)) == {Validity.VALID}


def test_estimates_stay_valid_in_a_turn_on_an_incline():
    """The tilt of odom is constant in odom; seen from base_link it turns."""
    motion = Walk(speed=0.0, turn=0.1, incline=np.radians(10.0))
    after = [
        e for e in run(noisy(motion, 30.0, 4), SETTINGS)[0] if e.stamp > 3.0 * SECOND
    ]
    assert set(validities(after)) == {Validity.VALID}


def test_a_clock_set_back_gives_the_estimates_of_a_new_estimator():
    first, second = noisy(Walk(), 3.0, 8, GYRO_BIAS), noisy(Walk(), 1.0, 9)
    estimates, _ = run(first + second)
    fresh, _ = run(second)
    assert same(estimates[-len(fresh) :], fresh)


def test_repeated_and_older_stamps_are_ignored():
    messages = noisy(Walk(), 1.0, 10)
    double = [
        m for i, m in enumerate(messages) for m in (m, messages[max(i - 9, 0)], m)
    ]
    assert same(run(double)[0], run(messages)[0])


def test_arbitrary_data_never_raises_and_never_gives_nan():
    rng = np.random.default_rng(11)
    odd = [np.nan, np.inf, -np.inf, 0.0, 1.0, -1.0, 1e-300, 1e300, 30.0, 9.81]
    estimator, stamp, count = StateEstimator(SETTINGS), 0, 0
    for _ in range(4000):
        stamp += int(
            rng.choice([0, 1, 5_000_000, 33_000_000, 10**9, -(10**7), -(10**10)])
        )
        w, f, p, v = (
            rng.choice(odd[3 if rng.random() < 0.9 else 0 :], 3) for _ in range(4)
        )
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
    for k in range(
        1000, 2000
    ):  # 1 ns apart: no wait is over, only the full queue decides
        estimator.add_odometry(k, *reading)
    assert [e.stamp for e in iter(estimator.poll, None)] == list(range(1992, 1997))
