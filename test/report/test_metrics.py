"""Metrics of synthetic walks against closed forms.

The Dynamic Constraint Map of synthetic bags, and of one with older messages.

Plots of a walk: the data in each panel, the size of the files, and that they are not blank.

scripts/compare: what differs between two bags, figure by figure, and what it refuses.
"""

import math
import operator
import re
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from bag_messages import WALL, message, write_messages, write_old
from PIL import Image
from real_graph import set_values
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.dynamics.servo import read_servo
from slot_core.recording.origin import Origin, origin_here
from slot_core.robot import LEGS, TENDON_JOINTS, read_robot
from slot_lab.bags.bag import Bag
from slot_lab.bags.recorded_walk import Ticks, TorsoTrack, stride_mean
from slot_lab.bags.topics import PLANS
from slot_lab.report import compare, constraint_map, plots, robot_drawing
from slot_lab.report.map_command import main
from slot_lab.report.metrics import figures, walk_metrics
from slot_lab.report.run_comparison import (
    compare_figures,
    exceeded,
    origin_lines,
    plot,
)

ROBOT = read_robot()
RATE = 30  # Hz, odometry
TRUTH_RATE = 120  # Hz, a multiple of RATE: both have a sample at every odometry
NODES = 22
STRIDE = 0.72  # s
TORSO_HEIGHT = 0.06  # m


@dataclass(frozen=True)
class Walk:
    """A straight walk, or with a yaw rate a circular one, with a swinging torso."""

    duration: float = 4.0  # s
    speed: float = 0.05  # m/s
    course: float = 0.0  # rad, of the motion to the left of the heading
    yaw_rate: float = 0.0  # rad/s; yaw starts at zero
    roll: float = 0.0  # rad, amplitude of roll = A sin(2 pi t / STRIDE)
    bounce: float = 0.0  # m, amplitude of the height
    latencies: tuple = (0.002, 0.001, 0.006, 0.001)  # s per stage
    real_time_factor: float = 1.0
    unanswered: tuple = ()  # ticks without a command
    lost: tuple = ()  # ticks without odometry, and so without any message
    unrecorded: tuple = ()  # ticks whose odometry the recorder lost
    late: tuple = ()  # ticks whose MPC takes a control period longer
    fallback: tuple = ()  # ticks whose MPC found no solution
    rejected: tuple = ()  # ticks whose odometry the estimator rejected
    truth: bool = True  # ground truth is recorded
    voltage: float = 11.1  # V, as the servos report it; NaN: not
    start: float = 100.0  # s, graph time of the first tick

    def position(self, t):
        """(3,) m at time t after the start."""
        turned = self.yaw_rate * t
        # of an arc with that turn
        chord = self.speed * t * np.sinc(turned / (2 * np.pi))
        direction = self.course + turned / 2
        height = TORSO_HEIGHT + self.bounce * np.sin(2 * np.pi * t / STRIDE)
        return np.array(
            [chord * np.cos(direction), chord * np.sin(direction), height]
        )

    def rpy(self, t):
        """(3,) rad."""
        return np.array(
            [self.roll * np.sin(2 * np.pi * t / STRIDE), 0.0, self.yaw_rate * t]
        )

    def velocity(self, t):
        """(3,) m/s in odom."""
        rate = 2 * np.pi / STRIDE
        lift = self.bounce * rate * np.cos(rate * t)
        course = self.course + self.yaw_rate * t
        return np.array(
            [self.speed * np.cos(course), self.speed * np.sin(course), lift]
        )


def write_walk(path, walk):
    """Write the bag of a walk."""
    entries = [
        (WALL + round(1e9 * (t / walk.real_time_factor + delay)), topic, built)
        for t, delay, topic, built in (*_ticks(walk), *_truth(walk))
    ]
    return write_messages(path, sorted(entries, key=operator.itemgetter(0)))


def _ticks(walk):
    """Messages of every tick, each after its time, its delay (s) and its topic."""
    for tick in range(round(walk.duration * RATE) + 1):
        if tick in walk.lost:
            continue
        t = tick / RATE
        delays = np.cumsum(walk.latencies)
        if tick in walk.late:
            delays[2:] += 1 / RATE
        for topic, fields in _fields(walk, tick, t).items():
            if tick in walk.unanswered and topic == "/desired_joint_angles":
                continue
            if tick in walk.unrecorded and topic == "/odom":
                continue
            delay = delays[STAGES[topic]] if topic in STAGES else 0.0
            yield t, delay, topic, message(topic, walk.start + t, **fields)


STAGES = {  # whose latency has passed when a topic is published
    "/mpc_state": 0,
    "/gait_preview": 1,
    "/tendon_plan": 2,
    "/desired_joint_angles": 3,
    "/force_map/status": 3,
}


def _fields(walk, tick, t):
    """Fields of the messages of a tick by topic."""
    normal, fails = normal_forces(t), tick in walk.fallback
    return {
        "/odom": _odometry(walk, t),
        "/mpc_state": {
            "rpy": walk.rpy(t),
            "position": walk.position(t),
            "linear_velocity": walk.velocity(t),
            "validity": 2 if tick in walk.rejected else 0,
        },
        "/gait_preview": {
            "gait": "walk",
            "period": STRIDE,
            "phase": (t / STRIDE) % 1.0,
            "velocity": [0.05, 0.0, 0.0],
        },
        "/tendon_plan": {
            "stages": 1,
            "force": np.column_stack([np.zeros((4, 2)), normal]),
            "status": int(fails),
            "fallback_cycles": int(fails),
            "violation": 1e-6 * (tick + 1),
            "slack_normal_min": normal,
            "slack_normal_max": 6.0 - normal,
            "slack_friction": 0.4 * normal - 0.5,
        },
        "/desired_joint_angles": {
            "name": TENDON_JOINTS,
            "position": angles(t),
        },
        "/force_map/status": {"saturated": angles(t) >= np.radians(100.0)},
        "/robot_state": {"action": 3},
        "/servo_health": {"action": 3, "voltage": [walk.voltage] * 4},
        "/stage_record": {},
    }


def _odometry(walk, t):
    rotation = Rotation.from_euler("xyz", walk.rpy(t))
    return {
        "pose__pose__position": walk.position(t),
        "pose__pose__orientation": rotation.as_quat(),
        "twist__twist__linear": rotation.inv().apply(walk.velocity(t)),
    }


def swing(t):
    """(4,) a sine per leg, each at another phase."""
    return np.sin(
        2 * np.pi * t / STRIDE + np.pi * np.array([0.0, 1.0, 0.5, -0.5])
    )


def angles(t):
    """(4,) rad, plausible tendon angles."""
    return np.radians(65.0 + 38.0 * swing(t))


def normal_forces(t):
    """(4,) N, plausible normal forces whose sum is the weight."""
    return ROBOT.weight / 4 * (1 + 0.5 * swing(t))


def _truth(walk):
    """Messages of the simulated robot, as those of `_ticks`."""
    for k in range(round(walk.duration * TRUTH_RATE) + 1 if walk.truth else 0):
        t = k / TRUTH_RATE
        force = np.column_stack(
            [
                0.1 * normal_forces(t),
                np.zeros(4),
                1.05 * normal_forces(t - 0.03),
            ]
        )
        fields = {
            "/ground_truth/odom": _odometry(walk, t),
            "/joint_states": {  # in the reverse order of the legs: a driver may publish any order
                "name": TENDON_JOINTS[::-1],
                "position": (0.97 * angles(t - 0.04))[::-1],
                "velocity": np.zeros(4),
                "effort": np.array([0.5, 2.0 if t >= 2.0 else 0.5, 0.5, 0.5]),
            },
            "/ground_truth/legs": {
                "tension": 50 * angles(t),
                "ground_force": force,
                "nodes": NODES,
                "position": leg_nodes(walk, t),
            },
        }
        for topic, values in fields.items():
            if k % 4 == 0 or topic != "/ground_truth/legs":
                yield t, 0.0, topic, message(topic, walk.start + t, **values)


def leg_nodes(walk, t):
    """(4, NODES, 3) m: straight from the clamps to the floor."""
    turn = Rotation.from_euler("xyz", walk.rpy(t))
    clamps = walk.position(t) + turn.apply(ROBOT.clamps)
    feet = clamps + 0.145 * ROBOT.outward
    feet[:, 2] = 0.0
    return np.linspace(clamps, feet, NODES, axis=1)


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


@pytest.mark.parametrize("unrecorded", [(), (LAST // 2, LAST)])
def test_real_time_factor_is_graph_time_over_wall_time(metrics_of, unrecorded):
    m = metrics_of(replace(TIMING, real_time_factor=0.5, unrecorded=unrecorded))
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


def write_cycles(path, cycles):
    """A bag of cycles given by their fields, 30 a second."""
    plans = [
        message(PLANS, 10.0 + k / 30, **each) for k, each in enumerate(cycles)
    ]
    return write_messages(
        path, [(WALL + k, PLANS, p) for k, p in enumerate(plans)]
    )


def cycle(friction=1.0, status=0, balance=np.inf):
    return {
        "slack_normal_min": np.full(4, 5.0),
        "slack_normal_max": np.full(4, 7.0),
        "slack_friction": np.array([1.0, 1.0, friction, 1.0]),
        "slack_angle": np.full(4, 0.5),
        "slack_rate": np.full(4, 40.0),
        "slack_total": 28.0,
        "slack_balance": balance,
        "status": status,
    }


@pytest.fixture
def slipping(tmp_path):
    """Sixty cycles; the rear left leg slips in three of them, of which two are not solved."""
    cycles = [cycle() for _ in range(60)]
    cycles[20] = cycle(friction=-0.25)
    cycles[21] = cycle(friction=-0.9e-4, status=1)
    cycles[22] = cycle(friction=-0.125, status=4)
    return write_cycles(tmp_path / "slipping", cycles)


def test_every_constraint_has_a_row_of_slack(slipping):
    found = constraint_map.read_map(Bag(slipping))
    assert len(found.constraints) == 4 * 5 + 2
    slack = dict(zip(found.constraints, found.slack))
    assert slack["RL friction"][20:23] == pytest.approx(
        [-0.25, -0.9e-4, -0.125]
    )
    assert slack["FR largest normal"] == pytest.approx(np.full(60, 7.0))
    assert slack["total support"] == pytest.approx(np.full(60, 28.0))
    # A violation is slack below the solver's tolerance, 1e-4.
    assert found.violated.sum(axis=0)[20:23].tolist() == [1, 0, 1]


def test_a_single_violated_cycle_shows_in_a_long_walk(tmp_path, monkeypatch):
    """Cycles that share a column of the plot show the least slack among them."""
    monkeypatch.setattr(constraint_map, "CAPACITY", 10)
    cycles = [cycle(friction=-0.5 if k == 33 else 1.0) for k in range(95)]
    found = constraint_map.read_map(
        Bag(write_cycles(tmp_path / "long", cycles))
    )
    shown = constraint_map.map_figure(found).axes[0].collections[0].get_array()
    assert shown.shape == (21, 10)
    assert (shown < 0).sum() == 1


def test_fields_missing_from_older_messages_are_listed_and_left_out(tmp_path):
    plan = message(PLANS, 1.0, **cycle())
    found = constraint_map.read_map(
        Bag(write_old(tmp_path / "older", PLANS, plan))
    )
    assert "slack_balance" in found.missing
    assert not any("balance" in name for name in found.constraints)


def test_the_command_draws_a_bag_and_its_exit_code_reports_violations(
    tmp_path, slipping, capsys
):
    clean = write_cycles(
        tmp_path / "clean", [cycle(status=int(k == 5)) for k in range(30)]
    )
    assert main([str(clean), "--out", str(tmp_path / "map.png")]) == 0
    assert "NOT_SOLVED 1" in capsys.readouterr().out
    assert (tmp_path / "map.png").exists()
    assert main([str(slipping)]) == 1
    assert (tmp_path / "slipping_constraints.png").exists()
    assert "-0.2500 N" in capsys.readouterr().out


PLOTTED = Walk(duration=5.0, course=0.02, roll=0.1, bounce=0.004, late=(50,))

# of stamps and doubles; the plotted values are of order 1 to 100
CLOSE = 1e-6


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return Bag(write_walk(tmp_path_factory.mktemp("bags") / "walk", PLOTTED))


@pytest.fixture(scope="module")
def metrics(bag):
    return walk_metrics(bag, WARM_UP, read_servo())


def line(ax, label):
    (found,) = [drawn for drawn in ax.lines if drawn.get_label() == label]
    return found.get_xdata(), found.get_ydata()


def test_the_panels_show_the_motion_in_their_units_and_each_leg_in_its_own(
    bag, metrics
):
    figure = plots.dashboard_figure(bag, metrics)
    axes = {ax.get_label(): ax for sub in figure.subfigs for ax in sub.axes}
    x, y = line(axes["path"], "torso")
    assert np.allclose(y, np.tan(0.02) * x, atol=CLOSE)
    t, z = axes["height"].lines[0].get_data()  # mm
    assert np.allclose(
        z, 60 + 4 * np.sin(2 * np.pi * t / STRIDE), atol=CLOSE * 1e3
    )
    t, roll = line(axes["tilt"], "roll")  # deg
    turn = np.degrees(0.1) * np.sin(2 * np.pi * t / STRIDE)
    assert np.allclose(roll, turn, atol=1e-4)
    for i, leg in enumerate(LEGS):
        t, desired = line(axes[f"angle {leg}"], "desired")
        assert np.allclose(
            desired, [np.degrees(angles(s))[i] for s in t], atol=1e-4
        )
        t, true = line(axes[f"force {leg}"], "true")
        expected = [1.05 * normal_forces(s - 0.03)[i] for s in t]
        assert np.allclose(true, expected, atol=CLOSE * 10)


def test_plots_are_not_empty_and_an_animation_ends_with_the_walk(
    bag, metrics, tmp_path, monkeypatch
):
    plots.dashboard(bag, metrics, tmp_path / "new" / "walk.png")
    pixels = matplotlib.image.imread(tmp_path / "new" / "walk.png")[..., :3]
    assert 0.03 < float((pixels.min(axis=2) < 0.9).mean()) < 0.6
    times = robot_drawing.frame_times(bag)
    assert times[-1] == pytest.approx(PLOTTED.start + PLOTTED.duration)
    monkeypatch.setattr(robot_drawing, "frame_times", lambda bag: times[:3])
    robot_drawing.animate(bag, tmp_path / "walk.gif")
    with Image.open(tmp_path / "walk.gif") as plot:
        assert (plot.n_frames, plot.info["loop"]) == (3, 0)


BAGS = Path(__file__).parents[1] / "bags"
FLAT = Walk(duration=2 * STRIDE)
FASTER = replace(FLAT, speed=0.06)
# the bags of the repository are shorter than the warm-up
SEEN = ["--warm-up", "0"]


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    """The bags of FLAT and FASTER."""
    place = tmp_path_factory.mktemp("bags")
    return [
        Bag(write_walk(place / f"walk_{walk.speed}", walk))
        for walk in (FLAT, FASTER)
    ]


def pairs_of(bags):
    return compare_figures(
        *(figures(walk_metrics(bag, 0.0, read_servo())) for bag in bags)
    )


def test_differences_of_two_synthetic_walks_are_those_of_their_speeds(walks):
    found = {pair.first.name: pair for pair in pairs_of(walks)}
    speed, height = found["mean_v_x"], found["height_mean"]
    assert (speed.difference, speed.first.unit) == (pytest.approx(0.01), "m/s")
    assert height.first.value == pytest.approx(60.0)  # mm
    assert height.difference == 0.0
    # ms
    assert found["stages.mpc_controller.p99"].first.value == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("tolerances", "beyond"),
    [
        ((), []),
        ((("mean_v_?", 0.0101),), []),
        (
            (("mean_v_x", 0.0099),),
            ["mean_v_x +0.01 m/s, more than 0.0099 m/s"],
        ),
        ((("*", 0.0), ("*", 0.1)), []),  # the last one counts
        ((("height*", 0.0),), []),
    ],
)
def test_figures_beyond_their_tolerance_are_named(walks, tolerances, beyond):
    assert exceeded(pairs_of(walks), tolerances) == [
        f"beyond the tolerance: {line}" for line in beyond
    ]


def test_a_figure_of_one_bag_only_exceeds_every_tolerance(walks, tmp_path):
    """The other has no ground truth, and so no torques."""
    blind = Bag(write_walk(tmp_path / "blind", replace(FLAT, truth=False)))
    pairs = pairs_of([walks[0], blind])
    assert math.isinf(
        next(p for p in pairs if p.first.name == "servo_load.FL").difference
    )
    line = exceeded(pairs, [("servo_load.FL", 100.0)])
    assert line == ["beyond the tolerance: servo_load.FL is in one bag only"]


def test_a_bag_compared_with_itself_and_with_another_ends_with_0_and_1(capsys):
    walk, fault = str(BAGS / "walk"), str(BAGS / "fault")
    assert compare.main([walk, walk, *SEEN, "--tolerance", "*=0"]) == 0
    assert compare.main([walk, fault, *SEEN, "--tolerance", "tilt*=1"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert "scene                   flat -> fault" in lines
    assert any(
        re.match(r"beyond the tolerance: tilt_max [+-]\d", line)
        for line in lines
    )


def changed(bag, path, origin):
    """A copy of a bag with another origin."""
    bag.origin, kept = origin, bag.origin
    bag.save(path)
    bag.origin = kept
    return Bag(path)


def test_what_differs_between_the_origins_is_named(walks, tmp_path, own_config):
    route = tmp_path / "way.csv"
    route.write_text("x,y\n0,0\n1,0\n")
    first = changed(
        walks[0], tmp_path / "a", origin_here({"gait": "walk", "seed": 1})
    )
    speed = config.load("gait/walk")["forward"]["speed"]
    set_values(own_config, {"gait/walk": {"forward.speed": 0.03}})
    (own_config / "leg_map.csv").unlink()
    now = origin_here({"gait": "walk", "seed": 2, "path": str(route)})
    second = changed(
        walks[1],
        tmp_path / "b",
        Origin({**now.about, "revision": "new"}, now.files),
    )
    assert origin_lines(first, first)[-1].split() == [
        "configuration",
        "the",
        "same",
    ]
    assert origin_lines(first, walks[1])[-1].endswith(
        "recorded -> not recorded"
    )
    lines = origin_lines(first, second)
    assert re.fullmatch(r"revision +\S+ -> new", lines[0])
    assert [" ".join(line.split()) for line in lines[1:]] == [
        "policy rollout_mpc",
        "seed 1 -> 2",
        "path - -> way.csv",
        "the same gait walk",
        "path.csv - -> a file",
        f"gait/walk.yaml forward.speed {speed} -> 0.03",
        "leg_map.csv a file -> -",
    ]


def test_the_plot_has_both_walks_and_their_difference(walks, tmp_path):
    forward, difference = plot(*walks).axes[:2]
    assert [len(ax.lines) for ax in (forward, difference)] == [2, 1]
    t, change = difference.lines[0].get_data()
    assert change == pytest.approx(0.01 * t, abs=1e-9)
    bags, out = [str(bag.path) for bag in walks], tmp_path / "new" / "c.svg"
    assert compare.main([*bags, *SEEN, "--plot", str(out)]) == 0
    assert out.read_text().startswith("<?xml")
