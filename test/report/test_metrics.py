"""Metrics of synthetic walks against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_walk import RATE, STRIDE, Walk, write_walk

from slot_core.dynamics.servo import read_servo
from slot_lab.bags.bag import Bag
from slot_lab.bags.recorded_walk import Ticks, TorsoTrack, stride_mean
from slot_lab.report.metrics import walk_metrics

COURSE = 0.01  # rad
WALK = Walk(duration=4 * STRIDE + 1.0, course=COURSE, roll=0.1, bounce=0.004)
# a smaller bag, for tests of the ticks alone
TIMING = replace(WALK, truth=False)
LAST = round(TIMING.duration * RATE)  # tick
WARM_UP = 1.0  # leaves four whole strides
SAMPLES = round(WALK.duration * 120) - round(WARM_UP * 120) + 1
# of which the third leg's torque is high
OVER = round(WALK.duration * 120) - 2 * 120 + 1
SERVO = read_servo()
ROUNDING = 1e-9  # positions and speeds are doubles of order one


@pytest.fixture(scope="module")
def metrics_of(tmp_path_factory):
    known = {}

    def compute(walk, warm_up=WARM_UP):
        if (walk, warm_up) not in known:
            path = write_walk(tmp_path_factory.mktemp("bags") / "walk", walk)
            known[walk, warm_up] = walk_metrics(Bag(path), warm_up, SERVO)
        return known[walk, warm_up]

    return compute


def test_a_straight_rolling_walk_has_the_figures_of_its_closed_form(metrics_of):
    m = metrics_of(WALK)
    # 2.88 s: not a whole number of odometries, but of ground truth samples
    duration = 4 * STRIDE
    assert m.duration == pytest.approx(
        math.floor(duration * 120) / 120, abs=1 / 120
    )
    assert m.distance == pytest.approx(0.05 * m.duration, abs=ROUNDING)
    assert m.mean_v_x == pytest.approx(0.05 * math.cos(COURSE), abs=ROUNDING)
    assert m.mean_v_y == pytest.approx(0.05 * math.sin(COURSE), abs=ROUNDING)
    assert m.lateral_drift_end == pytest.approx(
        0.05 * m.duration * math.sin(COURSE), abs=ROUNDING
    )
    assert m.lateral_drift_max == pytest.approx(
        abs(m.lateral_drift_end), abs=ROUNDING
    )
    assert m.yaw_drift == pytest.approx(0.0, abs=ROUNDING)
    # Sampling a sine at 120 Hz misses its peak by at most 1 - cos(pi / (120 STRIDE)) = 7e-4; the
    # spans of whole strides are cut to samples, which moves the RMS by half a sample in 345.
    assert m.tilt_max == pytest.approx(0.1, rel=1e-3)
    assert m.tilt_rms == pytest.approx(0.1 / math.sqrt(2), rel=3e-3)
    assert m.height_mean == pytest.approx(0.06, abs=0.004 * 3e-3)
    assert m.height_std == pytest.approx(0.004 / math.sqrt(2), rel=3e-3)
    # The third leg's torque exceeds the limit from t = 2 s on; joints are recorded in reverse.
    assert m.servo_saturated == pytest.approx((0.0, 0.0, OVER / SAMPLES, 0.0))
    # Angles 65 + 38 sin(phase) deg exceed 100 deg for acos(35 / 38) / pi of a stride; counted in
    # odometries, a stride of 21.6 of them is right to one in 21.
    assert m.saturated == pytest.approx(
        (math.acos(35 / 38) / math.pi,) * 4, abs=1 / 21
    )


@pytest.mark.parametrize("angle", [0.0, 1e-9, 3.0])
def test_tilt_is_the_angle_between_the_z_axes_whatever_the_yaw(angle):
    tilt = Rotation.from_rotvec(
        angle * np.array([np.cos(0.7), np.sin(0.7), 0.0])
    )
    yawed = (Rotation.from_euler("z", 2.0) * tilt).as_quat()
    motion = TorsoTrack(
        "", np.zeros(1), np.zeros((1, 3)), np.array([yawed]), np.zeros((1, 3))
    )
    assert motion.tilt[0] == pytest.approx(angle, rel=1e-12)


def test_circular_walk_has_its_speed_along_the_momentary_heading(metrics_of):
    m = metrics_of(Walk(duration=4.0, yaw_rate=0.4, course=0.2))
    # Chords between samples 1/120 s apart are shorter than the arcs by (yaw_rate / 120)^2 / 24.
    assert m.mean_v_x == pytest.approx(0.05 * math.cos(0.2), rel=1e-6)
    assert m.mean_v_y == pytest.approx(0.05 * math.sin(0.2), rel=1e-6)
    assert m.yaw_drift == pytest.approx(0.4 * 4.0, abs=ROUNDING)
    assert m.distance == pytest.approx(
        2 * 0.05 / 0.4 * math.sin(0.4 * 3.0 / 2), abs=ROUNDING
    )


def test_injected_latencies_come_out_per_stage(metrics_of):
    injected = (0.0021, 0.0009, 0.0123, 0.0004)
    m = metrics_of(replace(TIMING, latencies=injected))
    for stage, expected in zip(m.stages.values(), injected):
        for figure in (stage.p50, stage.p99, stage.max):
            # doubles of wall time in s
            assert figure == pytest.approx(expected, abs=1e-6)
    assert m.end_to_end.p50 == pytest.approx(sum(injected), abs=1e-6)
    assert list(m.stages) == [
        "state_estimator",
        "gait_scheduler",
        "mpc_controller",
        "force_mapper",
    ]


def test_late_and_missing_commands_are_misses(metrics_of):
    clean = metrics_of(TIMING)
    assert (clean.deadline_misses, clean.unanswered, clean.missed_ticks) == (
        0,
        0,
        0,
    )
    m = metrics_of(
        replace(TIMING, late=(60, 61), unanswered=(70,), fallback=(40, 90))
    )
    assert (m.deadline_misses, m.unanswered) == (3, 1)
    assert (m.ticks, m.end_to_end.count) == (clean.ticks, clean.ticks - 1)
    assert (m.fallback_cycles, m.longest_fallback) == (2, 1)
    assert m.violation_max == pytest.approx(1e-6 * (LAST + 1), rel=1e-12)


@pytest.mark.parametrize(
    ("change", "missed", "fewer"),
    # gaps in the odometry
    [
        ({"unanswered": (LAST,)}, 0, 1),
        ({"lost": (50, 80, 81)}, 3, 3),
    ],
)
def test_a_command_cut_off_by_the_end_and_gaps_are_no_deadline_misses(
    metrics_of, change, missed, fewer
):
    m = metrics_of(replace(TIMING, **change))
    assert (m.missed_ticks, m.deadline_misses) == (missed, 0)
    assert m.ticks == metrics_of(TIMING).ticks - fewer


@pytest.mark.parametrize(
    ("warm_up", "counted"), [(WARM_UP, (0, 0, 0, 0)), (0.0, (2, 1, 1, 1))]
)
def test_events_in_the_warm_up_are_left_out(metrics_of, warm_up, counted):
    walk = replace(
        TIMING, unanswered=(3,), late=(5,), fallback=(6,), rejected=(7,)
    )
    m = metrics_of(walk, warm_up)
    assert counted == (
        m.deadline_misses,
        m.unanswered,
        m.fallback_cycles,
        m.unusable_states,
    )


def test_real_time_factor_is_graph_time_over_wall_time(metrics_of):
    m = metrics_of(replace(TIMING, real_time_factor=0.5))
    assert m.real_time_factor == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize(
    ("voltage", "stall"),
    # NaN: nominal
    [
        (11.1, 1.4),
        (9.6, 1.0 + 0.4 * 0.6 / 2.1),
        (12.6, 1.5),
        (math.nan, 1.4),
    ],
)
def test_load_is_the_mean_torque_over_the_stall_torque_at_the_supply_voltage(
    metrics_of, voltage, stall
):
    m = metrics_of(replace(WALK, voltage=voltage))
    stall *= SERVO.servo_per_tendon  # N m on the tendon angle
    # Torques are 0.5 N m, of the third leg 2 N m from t = 2 s on.
    third = (0.5 * (SAMPLES - OVER) + 2.0 * OVER) / SAMPLES
    assert m.servo_load == pytest.approx(
        np.array([0.5, 0.5, third, 0.5]) / stall, rel=1e-12
    )
    assert m.supply_voltage == pytest.approx(voltage, rel=1e-12, nan_ok=True)


def test_without_ground_truth_the_state_estimate_is_the_stated_source(
    metrics_of,
):
    truth = metrics_of(WALK)
    m = metrics_of(replace(WALK, truth=False))
    assert (truth.source, m.source) == ("/ground_truth/odom", "/mpc_state")
    assert m.mean_v_x == pytest.approx(0.05 * math.cos(COURSE), abs=ROUNDING)
    # 30 Hz samples miss the peak by 1 % at most
    assert m.tilt_max == pytest.approx(0.1, rel=2e-2)
    # no joint states either
    assert all(math.isnan(f) for f in (*m.servo_saturated, *m.servo_load))


def test_stride_mean_of_a_speed_with_ripple_is_the_speed():
    t = np.arange(0.0, 5.0, 1e-3)
    mean = stride_mean(t, 0.05 + 0.2 * np.sin(2 * np.pi * t / STRIDE), STRIDE)
    inside = (t >= STRIDE / 2) & (t <= t[-1] - STRIDE / 2)
    assert np.array_equal(np.isfinite(mean), inside)
    # trapezoids of 1 ms: error (2 pi h / T)^2 / 12 of the ripple, below 1.3e-6
    assert np.allclose(mean[inside], 0.05, atol=2e-6)


def test_stages_that_publish_after_the_command_have_no_latency_but_the_whole_has():
    """Nodes in one process publish the command first."""
    time = np.array([[0.0, 0.1, 0.3, 0.6, 1.0], [2.0, 2.6, 2.7, 2.8, 2.5]])
    ticks = Ticks(np.arange(2), time, 0.033, 3.0)
    np.testing.assert_allclose(ticks.latency[0], [0.1, 0.2, 0.3, 0.4])
    assert np.isnan(ticks.latency[1]).all()
    np.testing.assert_allclose(ticks.end_to_end, [1.0, 0.5])
