"""Gait scheduler: phase, blends, contact schedule and rejected requests."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core.clock import SECOND
from slot_core.config import ConfigError, build
from slot_core.control.gait import Gait, GaitScheduler, GaitSettings, read_gaits
from slot_core.control.reference import reference
from slot_core.robot import read_robot

REST = [0.0, 0, 0, 0, 0]
LEVEL = np.zeros(12)
STAND = {
    "period": 1.0,
    "cruise": 0.0,
    "speed": [0.0],
    "amplitude": [0.0],
    "angle_deg": [[60.0, 0, 0, 0, 0]] * 4,
    "range_deg": [10.0, 108.0],
    "normal_force": [[5.3, 0, 0, 0, 0]] * 4,
    "sway": {
        "roll": REST,
        "pitch": REST,
        "height": [0.05, 0, 0, 0, 0],
        "v_x": REST,
        "v_y": REST,
    },
}
WALK = {
    "period": 0.8,
    "cruise": 0.06,
    "speed": [0.0, 0.08],
    "amplitude": [0.0, 1.0],
    "angle_deg": [[80, 20, 0, 5, 0], [80, -20, 0, 5, 0], [90, 0, 30, 0, 0], [90, 0, -30, 0, 0]],
    "range_deg": [10.0, 108.0],
    "normal_force": [[5.3, 3, 0, 0, 0], [5.3, -6, 0, 0, 0], [5.3, 0, 2, 0, 0], [5.3, 0, -2, 0, 0]],
    "sway": {
        "roll": [0, 0.1, 0, 0, 0.01],
        "pitch": [0.02, 0, 0, 0, 0.1],
        "height": [0.06, 0, 0, 0.005, 0],
        "v_x": REST,
        "v_y": [0, 0.08, 0, 0, 0],
    },
}


@pytest.fixture
def settings():
    table = {
        "friction": 0.4,
        "contact_force": 0.5,
        "transition": 1.0,
        "velocity_timeout": 0.5,
        "stages": 15,
        "dt": 0.033,
        "gaits": {"stand": STAND, "walk": WALK},
    }
    return build(GaitSettings, table, "test")


def walking(settings, speed=0.08):
    """A scheduler that walks since t = 1 s, without a transition from `stand`."""
    scheduler = GaitScheduler(settings, "walk", np.array([speed, 0, 0]))
    scheduler.step(SECOND, LEVEL)
    return scheduler


def test_angles_are_the_harmonics_of_the_phase(settings):
    t = 3.21
    preview = walking(settings).step(SECOND + round(t * 1e9), LEVEL)
    p = 2 * np.pi * t / 0.8
    expected = [
        80 + 20 * np.cos(p) + 5 * np.cos(2 * p),
        80 - 20 * np.cos(p) + 5 * np.cos(2 * p),
        90 + 30 * np.sin(p),
        90 - 30 * np.sin(p),
    ]
    assert np.degrees(preview.tendon_angle[0]) == pytest.approx(np.clip(expected, 10, 108))
    assert preview.phase == pytest.approx(t / 0.8 % 1)


def test_stage_k_of_the_preview_is_stage_0_of_the_tick_k_later(settings):
    scheduler = walking(settings)
    early = scheduler.step(5 * SECOND, LEVEL)
    late = scheduler.step(5 * SECOND + 4 * 33_000_000, LEVEL)
    assert early.tendon_angle[4:] == pytest.approx(late.tendon_angle[:-4])
    assert early.normal_force[4:] == pytest.approx(late.normal_force[:-4])
    assert (early.contact[4:] == late.contact[:-4]).all()


def test_a_change_of_gait_is_continuous(settings):
    scheduler = GaitScheduler(settings, "walk", np.array([0.08, 0, 0]))
    stamps = SECOND + np.arange(0, 2 * SECOND, SECOND // 100)
    angles = np.array([scheduler.step(int(s), LEVEL).tendon_angle[0] for s in stamps])
    assert np.degrees(angles[0]) == pytest.approx(60.0)
    # the fastest harmonic moves 30 * 2 pi / 0.8 = 236 deg/s, the blend at most 50 deg/s
    assert np.degrees(np.abs(np.diff(angles, axis=0))).max() < 2.9


def test_a_leg_without_normal_force_is_not_in_contact(settings):
    preview = walking(settings).step(5 * SECOND, LEVEL)
    assert (preview.contact == (preview.normal_force >= 0.5)).all()
    assert (
        preview.normal_force.min() == 0.0
    )  # FR's harmonics go below zero, its normal force does not
    assert not preview.contact[:, 1].all()


def test_half_the_speed_is_half_the_amplitude(settings):
    full = walking(settings, 0.08).step(5 * SECOND, LEVEL).tendon_angle[:, 0]
    half = walking(settings, 0.04).step(5 * SECOND, LEVEL).tendon_angle[:, 0]
    assert half - np.radians(80) == pytest.approx((full - np.radians(80)) / 2, abs=1e-12)


def test_a_change_of_speed_keeps_the_phase(settings):
    scheduler = walking(settings, 0.08)
    scheduler.request("walk", np.array([0.04, 0, 0]))
    kept = scheduler.step(5 * SECOND, LEVEL)
    assert kept.phase == pytest.approx(4.0 / 0.8 % 1)


def test_a_velocity_command_expires(settings):
    scheduler = walking(settings)
    scheduler.step(5 * SECOND, LEVEL)
    scheduler.set_velocity(5 * SECOND, np.array([0.08, 0, 0]))
    fresh = scheduler.step(5 * SECOND + SECOND // 4, LEVEL)
    stale = scheduler.step(5 * SECOND + SECOND, LEVEL)
    assert fresh.reference[0, 9] == pytest.approx(0.08)
    assert stale.reference[0, 9] == 0.0
    stopped = scheduler.step(8 * SECOND, LEVEL)
    assert np.ptp(stopped.tendon_angle, axis=0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("stamp", [0, 10_000 * SECOND])
def test_a_command_with_a_stamp_far_from_the_states_stops_the_robot_and_raises(settings, stamp):
    """A stamp from the future might never expire, and an old command may be a late stop."""
    scheduler = walking(settings)
    scheduler.step(5 * SECOND, LEVEL)
    with pytest.raises(
        ConfigError, match=r"stamp is [+-]\d+\.000 s from the state's \(limit 0\.5 s"
    ):
        scheduler.set_velocity(stamp, np.array([0.08, 0, 0]))
    assert scheduler.step(5 * SECOND, LEVEL).reference[0, 9] == 0.0


def test_a_clock_set_back_does_not_delay_a_change_of_gait(settings):
    scheduler = walking(settings)
    scheduler.step(1000 * SECOND, LEVEL)
    scheduler.request("stand", np.zeros(3))
    assert scheduler.step(1000 * SECOND, LEVEL).gait == "stand"
    scheduler.request("walk", np.array([0.08, 0, 0]))
    gaits = [scheduler.step(second * SECOND, LEVEL).gait for second in (5, 6)]
    assert gaits == ["stand", "walk"]  # the transition of 1 s ends first


def test_a_request_during_a_transition_waits_for_its_end(settings):
    scheduler = walking(settings)
    scheduler.request("stand", np.zeros(3))
    assert scheduler.step(SECOND + SECOND // 2, LEVEL).gait == "walk"
    assert scheduler.step(2 * SECOND, LEVEL).gait == "stand"


def test_the_reference_moves_along_the_heading_at_the_start(settings):
    scheduler = GaitScheduler(settings, "walk", np.array([0.08, 0, 0]))
    state = LEVEL.copy()
    state[2:6] = [0.5, 1.0, 2.0, 0.055]
    scheduler.step(SECOND, state)
    state[2] = 0.9  # drifted
    stamps = 3 * SECOND + np.arange(0, 800_000_000, 33_000_000)
    rows = np.array([scheduler.step(int(s), state).reference[0] for s in stamps])
    mean = rows[:24].mean(axis=0)  # 24 ticks are 0.99 strides
    assert rows[:, 2] == pytest.approx(0.5)
    # the missing hundredth of a stride leaves 1 % of the sway in the mean
    assert mean[9:11] == pytest.approx(0.08 * np.array([np.cos(0.5), np.sin(0.5)]), abs=3e-3)
    ahead = scheduler.step(5 * SECOND, state).reference
    step = 0.08 * 0.033 * np.arange(16)
    assert ahead[:, 3] == pytest.approx(1.0 + np.cos(0.5) * step[:15])
    assert ahead[:, 4] == pytest.approx(2.0 + np.sin(0.5) * step[:15])


def test_the_rates_of_the_reference_are_the_derivatives_of_its_sway(settings):
    scheduler, h = walking(settings), 1_000_000
    before, now, after = (scheduler.step(5 * SECOND + d, LEVEL).reference for d in (-h, 0, h))
    difference = (after - before) / (2 * h * 1e-9)
    # central differences over 1 ms are off by (2 p / T h)^2 / 6 = 4e-5 of the value
    assert now[:, 6:8] == pytest.approx(difference[:, 0:2], abs=2e-4)
    assert now[:, 11] == pytest.approx(difference[:, 5], abs=2e-4)


@pytest.mark.parametrize(("heading", "yaw"), [(3.1, -3.1), (-3.1, 3.1), (9.0, 2.6), (0.2, 0.3)])
def test_the_reference_is_within_half_a_turn_of_the_state(heading, yaw):
    state = LEVEL.copy()
    state[2] = yaw
    rows = reference(state, heading, np.zeros(3), np.zeros((1, 12)), np.zeros(1))
    assert abs(rows[0, 2] - yaw) < np.pi
    assert np.exp(1j * rows[0, 2]) == pytest.approx(np.exp(1j * heading))


def test_sway_rotates_with_the_heading():
    """v = [v_x, v_y] and omega = [roll rate, pitch rate], rotated by yaw, are vectors in odom."""
    rng = np.random.default_rng(0)
    sway, times = rng.normal(size=(5, 12)), 0.033 * np.arange(5)
    rows = reference(LEVEL, 0.7, np.array([0.1, -0.2, 0.3]), sway, times)
    rotation = Rotation.from_euler("z", (0.7 + 0.3 * times)[:, None])
    flat = np.zeros(5)
    rates = rotation.apply(np.column_stack([sway[:, 6:8], flat]))
    speeds = rotation.apply(np.column_stack([sway[:, 9:11] + [0.1, -0.2], flat]))
    assert rows[:, 6:8] == pytest.approx(rates[:, :2])
    assert rows[:, 9:11] == pytest.approx(speeds[:, :2])
    assert rows[:, 8] == pytest.approx(0.3)
    assert rows[:, [0, 1, 5, 11]] == pytest.approx(sway[:, [0, 1, 5, 11]])


@pytest.mark.parametrize(
    ("gait", "velocity", "message"),
    [
        ("trot", [0, 0, 0], r"no gait 'trot' \(known: stand, walk\)"),
        ("walk", [0.2, 0, 0], r"v_x = 0\.2: gait walk reaches \[0, 0\.08\]"),
        ("walk", [float("nan"), 0, 0], r"v_x = nan: gait walk reaches"),
        ("walk", [0, 0.01, 0], r"v_y = 0\.01: gait walk reaches \[0, 0\]"),
        ("stand", [0.01, 0, 0], r"v_x = 0\.01: gait stand reaches \[0, 0\]"),
        ("walk", [0.05], r"velocity: 1 values, not v_x, v_y, yaw rate"),
    ],
)
def test_an_unknown_gait_or_velocity_out_of_range_is_rejected(settings, gait, velocity, message):
    with pytest.raises(ConfigError, match=message):
        GaitScheduler(settings, gait, np.array(velocity, dtype=float))


def test_a_speed_table_that_does_not_rise_is_rejected():
    with pytest.raises(ConfigError, match=r"speed = \(0\.1, 0\.1\): expected one rising value"):
        build(Gait, WALK | {"speed": [0.1, 0.1]}, "test")


def test_the_shipped_gaits_are_within_the_robots_limits():
    robot, settings = read_robot(), read_gaits()
    phase = np.linspace(0, 1, 200, endpoint=False)
    assert {"stand", "walk"} <= set(settings.gaits)
    for gait in settings.gaits.values():
        for amplitude in (0.0, 0.5, 1.0):
            angle, force, _ = np.split(gait.course(phase, amplitude), [4, 8], axis=1)
            assert angle.min() >= 0.0
            assert angle.max() <= robot.tendon.angle_max
            # over a stride the ground carries the weight; two harmonics miss some of it
            assert force.sum(axis=1).mean() == pytest.approx(robot.weight, rel=0.1)
        assert gait.speed[0] <= gait.cruise <= gait.speed[-1]
