"""Agreement of IMU and odometry: shift, axes, units and frames, on closed-form motions."""

import re

import numpy as np
import pytest
from estimator_streams import (
    GYRO_BIAS,
    SETTINGS,
    Walk,
    arrivals,
    changed,
    imu_messages,
    noisy,
    odometry_messages,
    run,
    same,
    validities,
)
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.clock import SECOND
from slot_core.estimation.estimate import Validity
from slot_core.geometry import OPTICAL, wrapped
from slot_core.robot import GRAVITY

COMPARED = config.replace(SETTINGS, {"agreement.enabled": True})
SEEDS, ALL = range(3), slice(None)
WALK = Walk()
# a circling axis would make a turn about z the same as a shift
WALK.omega[:3] *= [1.0, 1.6, 1.3]
REST = Walk(tilt=0.0, sway=0.0, speed=0.0)
REST.amplitude[2] = 0.0
NONE = "odom: no twist: velocities from the pose"


def imu_changed(messages, change):
    """The messages with `change(w, f)` in the IMU's samples."""
    return [
        (kind, t, change(*v) if kind == "imu" else v) for kind, t, v in messages
    ]


def stamped(kind, messages, shift):
    """The messages with stamps of a kind moved by `shift`, s, in the same order."""
    return [
        (k, t + round(shift * SECOND) * (k == kind), v) for k, t, v in messages
    ]


def turned(rotation):
    """IMU turned on the torso by a rotation (3, 3)."""
    return lambda w, f: (rotation.T @ w, rotation.T @ f)


def rotation(axes, angle):
    return Rotation.from_euler(axes, angle, degrees=True).as_matrix()


def settled(messages, shift=0.0):
    """Message of the last estimate, and the largest errors of angle, rad, and position, m."""
    estimates, _ = run(messages, COMPARED)
    last = estimates[-30:]
    assert set(validities(last)) == {Validity.VALID}
    truth = [WALK.at(e.time / SECOND - shift)[0][:6] for e in last]
    apart = np.array([e.state[:6] for e in last]) - truth
    apart[:, :3] = wrapped(apart[:, :3])
    worst = np.abs(apart).max(axis=0)
    return last[-1].message, worst[:3].max(), worst[3:].max()


# Three standard deviations of a filter of good sensors; today 8 mrad and 1.4 mm.
ANGLE, PLACE = 0.02, 0.004


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("shift", [0.0, 0.012, -0.02, 0.05, -0.05])
def test_a_shift_of_the_stamps_is_found_within_5_ms_and_compensated(
    shift, seed
):
    messages = noisy(WALK, 4.0, seed, GYRO_BIAS)
    line, angle, place = settled(stamped("imu", messages, shift), shift)
    found = re.search(r"stamps ([+-]\d+) ms", line)
    assert abs((int(found[1]) if found else 0) - 1e3 * shift) <= 5.0
    assert "compensated" in line or not shift
    assert angle < ANGLE
    assert place < PLACE


@pytest.mark.parametrize(
    ("shift", "line"),
    [(-0.09, "imu: stamps -90 ms"), (0.075, "imu: stamps +75 ms")],
)
def test_a_larger_shift_is_named_and_odometry_serves_alone(shift, line):
    estimates, _ = run(stamped("imu", noisy(WALK, 4.0, 0), shift), COMPARED)
    assert estimates[-1].message.startswith(line)
    assert "limit 60 ms: it is not used" in estimates[-1].message
    assert set(validities(estimates[-30:])) == {Validity.IMU_MISSING}


TURN = rotation("Z", 90)
MENDED = {
    "g": (lambda w, f: (w, f / 9.80665), "specific force 1.0 m/s2"),
    "deg/s": (lambda w, f: (np.degrees(w), f), "taken as deg/s"),
    "quarter": (turned(TURN), "mounts.imu.rpy: [0, 0, 1.571]"),
    "half": (turned(TURN @ TURN), "mounts.imu.rpy: [0, 0, 3.142]"),
    "aslant": (turned(rotation("X", 25)), "mounts.imu.rpy: [0.4"),
}


@pytest.mark.parametrize("case", MENDED)
def test_units_and_axes_that_motion_shows_are_compensated(case):
    change, expected = MENDED[case]
    for seed in SEEDS:
        messages = imu_changed(noisy(WALK, 5.0, seed), change)
        line, angle, place = settled(messages)
        assert expected in line
        assert angle < ANGLE
        assert place < PLACE


REFUSED = {
    "gravity": (lambda w, f: (w, f - [0, 0, GRAVITY]), "removed gravity?"),
    "gravity, aslant": (
        lambda w, f: (w, f - [0, 0, GRAVITY] + [0.9, 0, 0]),
        "removed gravity?",
    ),
    "gyro alone": (lambda w, f: (w, 0.0 * f), "accelerometer off?"),
    "optical": (turned(OPTICAL), "optical axes? mounts.imu.rpy: [-1.571, 0, -"),
    "over": (turned(rotation("X", 180)), "turned? mounts.imu.rpy: [3.142, 0, "),
    "side": (turned(rotation("Y", 90)), "turned? mounts.imu.rpy: [0, 1.571, 0"),
    "range": (
        lambda w, f: (w, 1.5 * f),
        "m/s2, expected 9.8: is it calibrated?",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_imu_that_is_wrong_at_rest_leaves_no_usable_estimate(case):
    change, expected = REFUSED[case]
    for seed in SEEDS:
        estimates, _ = run(
            imu_changed(noisy(REST, 1.0, seed), change), COMPARED
        )
        usable = {Validity.VALID, Validity.IMU_MISSING}
        assert not usable & set(validities(estimates))
        assert expected in estimates[-1].message


def test_a_gyroscope_without_turns_is_named_in_motion():
    messages = imu_changed(noisy(WALK, 3.0, 0), lambda w, f: (0.0 * w, f))
    assert "gyroscope off?" in run(messages, COMPARED)[0][-1].message


def in_odom(p, q, v, w):
    attitude = Rotation.from_quat(q)
    return p, q, attitude.apply(v), attitude.apply(w)


TWISTS = {  # of odometry, and the line
    "zeros": (lambda p, q, v, w: (p, q, 0.0 * v, 0.0 * w), NONE),
    "-1": (lambda p, q, v, w: (p, q, v + 9, w, np.repeat([0, -1], 6)), NONE),
    "odom": (in_odom, "odom: twist in the axes of odom"),
    "camera": (
        lambda p, q, v, w: (p, q, OPTICAL.T @ v, OPTICAL.T @ w),
        "odom: twist is none of the pose's motion",
    ),
}


@pytest.mark.parametrize("case", TWISTS)
def test_a_twist_that_is_not_that_of_base_link_is_mended_or_left(case):
    change, expected = TWISTS[case]
    for seed in SEEDS:
        messages = changed(noisy(Walk(yaw=0.6), 3.0, seed), ALL, change)
        estimates, _ = run(messages, COMPARED)
        assert expected in estimates[-1].message
        assert set(validities(estimates[-60:])) == {Validity.VALID}


@pytest.mark.parametrize("kind", ["odometry", "imu"])
@pytest.mark.parametrize("shift", [0.4, -0.4, -0.6])
def test_a_stray_stamp_is_dropped(kind, shift):
    messages = noisy(WALK, 3.0, 5)
    at = [i for i, m in enumerate(messages) if m[0] == kind][60]
    stray = stamped(kind, messages[at : at + 1], shift)
    without = messages[:at] + messages[at + 1 :]
    with_it = messages[:at] + stray + messages[at + 1 :]
    assert same(*[run(each, COMPARED)[0][-10:] for each in (without, with_it)])


def test_stamps_that_stay_ahead_are_named():
    estimates, _ = run(stamped("odometry", noisy(WALK, 3.0, 5), 0.4), COMPARED)
    assert "odom: stamps 0.4" in estimates[-1].message
    assert Validity.VALID not in validities(estimates)


@pytest.mark.parametrize("seed", SEEDS)
def test_good_sensors_need_no_line(seed):
    estimates, _ = run(noisy(Walk(yaw=seed), 6.0, seed, GYRO_BIAS), COMPARED)
    assert {e.message for e in estimates} == {""}


@pytest.mark.parametrize("tilt", [0.02, 0.05, 0.1, 0.22])
@pytest.mark.parametrize("seed", SEEDS)
def test_odometry_of_three_times_the_noise_contradicts_no_imu(seed, tilt):
    """Its noise is learned while the IMU says that the torso rests, for a second."""
    swaying, rng = Walk(tilt=tilt), np.random.default_rng(seed)
    swaying.omega[:3] = WALK.omega[:3]
    phases = [(noisy_part(REST, rng), 1.0), (noisy_part(swaying, rng), 7.0)]
    messages, begin = [], 0.0
    for part, duration in phases:
        end = begin + duration
        messages += [m for m in part if begin <= m[1] / SECOND < end]
        begin = end
    estimates, _ = run(messages, COMPARED)
    noise = "odom: noise [34] times that of estimator.yaml"
    shift = "imu: stamps [-+][0-5] ms against odometry's: compensated"
    lines = {x for e in estimates[60:] for x in e.message.split("; ") if x}
    assert all(re.fullmatch(f"{noise}|{shift}", line) for line in lines)
    assert any(re.fullmatch(noise, line) for line in lines)
    assert set(validities(estimates[60:])) == {Validity.VALID}


def noisy_part(motion, rng):
    """Eight seconds of readings, of the odometry with three times its noise."""
    return arrivals(
        imu_messages(motion, 8.0, rng=rng),
        odometry_messages(motion, 8.0, rng=rng, loud=3.0),
    )
