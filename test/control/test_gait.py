"""Gaits: strides as sums of patterns and their mirror images, postures, refused commands."""

import dataclasses
import math

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from slot_core.config import ConfigError
from slot_core.control.force_map import read_springs
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.gait.gait import FRONT_REAR, LEFT_RIGHT, Posture, read_gaits
from slot_core.gait.reference import places_ahead, reference
from slot_core.robot import read_robot
from slot_core.simulation.make_robot import make_robot

ROBOT, GAITS = read_robot(), read_gaits()
WALK = GAITS.strides["walk"]
PHASES = np.linspace(0.0, 1.0, 41)[:-1]
LEVEL = np.zeros(12)
NO_OFFSET = np.zeros(4)
# Signs of roll, pitch, yaw, p, omega, v under the reflection of x, and under that of y.
REFLECTED_X = np.array([1, -1, -1, -1, 1, 1, 1, -1, -1, -1, 1, 1], dtype=float)
REFLECTED_Y = np.array([-1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1], dtype=float)


def stride_table(velocity, phase=PHASES, stride=WALK, offset=NO_OFFSET):
    velocity = np.asarray(velocity, dtype=float)
    return stride.stride_table(phase, np.array(velocity), offset)


def harmonics(rows, phase):
    """Series (n, 4), from coefficients m, c1, s1, c2, s2 of each leg, written out."""
    p = 2 * np.pi * phase
    return np.column_stack(
        [
            m
            + c1 * np.cos(p)
            + s1 * np.sin(p)
            + c2 * np.cos(2 * p)
            + s2 * np.sin(2 * p)
            for m, c1, s1, c2, s2 in rows
        ]
    )


def filled(seed=1, size=0.2):
    """The walk with tables of load and sway that are not zero, small enough not to be clipped."""
    rng = np.random.default_rng(seed)

    def table(pattern):
        motion = {
            name: tuple(1e-3 * rng.normal(size=5))
            for name in ("roll", "pitch", "height")
        }
        speed = {name: tuple(1e-2 * rng.normal(size=5)) for name in ("v_x", "v_y")}
        load = tuple(map(tuple, 0.1 * rng.normal(size=(4, 5))))
        angle = tuple(map(tuple, size * np.array(pattern.angle_deg)))
        return dataclasses.replace(
            pattern, angle_deg=angle, normal_force=load, **motion, **speed
        )

    patterns = {
        name: table(getattr(WALK, name)) for name in ("forward", "lateral", "turn")
    }
    return dataclasses.replace(WALK, centre_deg=(60.0,) * 4, **patterns)


@pytest.mark.parametrize(
    ("name", "velocity"),
    [("forward", [1, 0, 0]), ("lateral", [0, 1, 0]), ("turn", [0, 0, 1])],
)
def test_at_the_speed_of_a_pattern_the_angles_are_its_harmonics_about_the_centre(
    name, velocity
):
    pattern = getattr(WALK, name)
    angle = np.degrees(stride_table(pattern.speed * np.array(velocity))[:, :4])
    expected = np.array(WALK.centre_deg) + harmonics(pattern.angle_deg, PHASES)
    assert angle == pytest.approx(np.clip(expected, *WALK.range_deg))


def test_the_amplitude_grows_with_the_velocity_and_patterns_of_two_directions_add_up():
    stride = filled()
    centre = stride_table([0, 0, 0], stride=stride)
    forward, half, lateral, both = (
        stride_table(v, stride=stride) - centre
        for v in ([0.03, 0, 0], [0.015, 0, 0], [0, -0.02, 0], [0.03, -0.02, 0])
    )
    assert half == pytest.approx(forward / 2, abs=1e-12)
    assert both == pytest.approx(forward + lateral, abs=1e-12)


def test_amplitudes_are_bounded_by_an_ellipsoid():
    stride = dataclasses.replace(filled(), amplitude_max=(1.0, 0.5, 1.0))
    ahead, aside = stride.forward.speed, stride.lateral.speed
    fast, share = stride_table([ahead, aside / 2, 0], stride=stride), 1 / math.sqrt(2)
    assert fast == pytest.approx(
        stride_table([share * ahead, share * aside / 2, 0], stride=stride)
    )
    sideways = stride_table([0, 0.2, 0], stride=stride)
    assert sideways == pytest.approx(stride_table([0, aside / 2, 0], stride=stride))


def test_offsets_shift_the_angles_within_the_range():
    offset = np.radians([5.0, -5.0, 90.0, -90.0])
    plain, shifted = (
        stride_table([0.05, 0, 0]),
        stride_table([0.05, 0, 0], offset=offset),
    )
    low, high = np.radians(WALK.range_deg)
    assert shifted[:, :2] == pytest.approx(
        np.clip(plain[:, :2] + offset[:2], low, high), abs=0.15
    )
    # 90 deg more or less leave little of the range.
    assert shifted[:, 2].min() > plain[:, 2].min() + np.radians(30.0)
    assert shifted[:, 3].max() < plain[:, 3].max() - np.radians(30.0)


def test_normal_forces_are_never_negative():
    stride = dataclasses.replace(filled(), centre_force=0.1)
    force = stride_table([0.07, 0, 0], stride=stride)[:, 4:8]
    assert force.min() == 0.0
    assert force.max() > 0.1


def test_rates_and_velocities_of_the_torso_are_the_derivatives_of_its_angles_and_sway():
    stride, h = filled(), 1e-6
    for velocity in ([0.05, 0, 0], [0.03, -0.03, 0.0], [0, 0, 0.1]):
        before, now, after = (
            stride_table(velocity, PHASES + d, stride)[:, 8:] for d in (-h, 0, h)
        )
        slope = (after - before) / (2 * h * stride.period)
        assert now[:, [6, 7, 11]] == pytest.approx(slope[:, [0, 1, 5]], abs=1e-7)
        about_mean = now[:, [9, 10]] - now[:, [9, 10]].mean(axis=0)
        assert about_mean == pytest.approx(slope[:, [3, 4]], abs=1e-7)
        assert now[:, [3, 4]].mean(axis=0) == pytest.approx(np.zeros(2), abs=1e-12)


MIRRORS = {
    "backward": ([0.05, 0, 0], [-0.05, 0, 0], FRONT_REAR, REFLECTED_X),
    "to the right": ([0, 0.05, 0], [0, -0.05, 0], LEFT_RIGHT, REFLECTED_Y),
    "turning right": ([0, 0, 0.1], [0, 0, -0.1], LEFT_RIGHT, REFLECTED_Y),
    "a right-hand bend": ([0.05, 0, 0.03], [0.05, 0, -0.03], LEFT_RIGHT, REFLECTED_Y),
    "a bend backward": ([0.05, 0, 0.03], [-0.05, 0, -0.03], FRONT_REAR, REFLECTED_X),
}


@pytest.mark.parametrize("case", [c for c in MIRRORS if c != "a right-hand bend"])
def test_the_opposite_velocity_is_the_mirror_image_half_a_stride_later(case):
    velocity, opposite, legs, signs = MIRRORS[case]
    stride = filled()
    there = stride_table(velocity, (PHASES + 0.5) % 1.0, stride)
    back = stride_table(opposite, PHASES, stride)
    assert back[:, :4] == pytest.approx(there[:, :4][:, legs], abs=1e-12)
    assert back[:, 4:8] == pytest.approx(there[:, 4:8][:, legs], abs=1e-12)
    assert back[:, 8:] == pytest.approx(signs * there[:, 8:], abs=1e-12)


def motion(velocity, phase, duration=2.8, stride=WALK):
    """States (n, 12) of the simulated robot on the flat floor, open loop, every 30 ms."""
    sim = make_robot(ROBOT, read_scene("flat"), read_servo())
    states, step = [], 0.03
    for k in range(round(duration / step)):
        at = np.array([(phase + k * step / stride.period) % 1.0])
        sim.advance(30, stride_table(velocity, at, stride)[0, :4])
        states.append(
            np.concatenate([sim.rpy, sim.position, sim.angular_velocity, sim.velocity])
        )
    return np.array(states)


@pytest.mark.parametrize("case", MIRRORS)
def test_the_simulated_robot_moves_with_the_opposite_velocity_in_the_mirror_image(case):
    """Four strides from rest; the robot, the floor and its numerics are symmetric.

    A bend to the right is the mirror image of one to the left only for a pattern that is symmetric
    itself: the forward pattern is, half a stride later.
    """
    velocity, opposite, _, signs = MIRRORS[case]
    there, back = motion(velocity, 0.5), motion(opposite, 0.0)
    assert np.abs(there[-1, 2:5]).max() > 0.02  # it has moved, or turned
    np.testing.assert_allclose(back, signs * there, rtol=0, atol=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_steering_alters_the_angles_in_proportion_to_the_yaw_rate(sign):
    plain = stride_table([0.05, 0, 0], stride=filled())
    one, two = (
        stride_table([0.05, 0, sign * w], stride=filled()) for w in (0.01, 0.02)
    )
    assert two - plain == pytest.approx(2 * (one - plain), abs=1e-12)
    assert np.abs(one[:, :4] - plain[:, :4]).max() > 1e-3


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.0])
def test_places_ahead_move_with_the_velocity_in_the_direction_of_the_heading(heading):
    velocity = np.tile([0.08, 0.02, 0.0], (16, 1))
    places = places_ahead(np.array([1.0, 2.0, heading]), velocity, 0.033)
    way = Rotation.from_euler("z", heading).apply([0.08, 0.02, 0.0])[:2]
    assert places[:, :2] == pytest.approx(
        [1.0, 2.0] + 0.033 * np.arange(16)[:, None] * way
    )
    turning = np.tile([0.1, 0.0, 0.5], (200, 1))  # a circle of 0.2 m
    x, y, yaw = places_ahead(np.array([0.0, 0.0, heading]), turning, 0.001)[-1]
    assert yaw == pytest.approx(heading + 0.5 * 0.199)
    expected = 0.2 * np.array(
        [np.sin(yaw) - np.sin(heading), np.cos(heading) - np.cos(yaw)]
    )
    assert [x, y] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    ("heading", "yaw"), [(3.1, -3.1), (-3.1, 3.1), (9.0, 2.6), (0.2, 0.3)]
)
def test_the_reference_is_within_half_a_turn_of_the_state(heading, yaw):
    state, still = LEVEL.copy(), np.zeros((1, 3))
    state[2] = yaw
    rows = reference(state, np.array([[0.0, 0.0, heading]]), still, np.zeros((1, 12)))
    assert abs(rows[0, 2] - yaw) < np.pi
    assert np.exp(1j * rows[0, 2]) == pytest.approx(np.exp(1j * heading))


def test_sway_rotates_with_the_heading():
    """v = [v_x, v_y], omega and the sway of x and y, rotated by yaw, are vectors in odom."""
    rng = np.random.default_rng(0)
    motion, place = rng.normal(size=(5, 12)), rng.normal(size=(5, 3))
    velocity = np.tile([0.1, -0.2, 0.3], (5, 1))
    rows = reference(LEVEL, place, velocity, motion)
    rotation, flat = Rotation.from_euler("z", rows[:, 2:3]), np.zeros(5)
    assert np.exp(1j * rows[:, 2]) == pytest.approx(np.exp(1j * place[:, 2]))
    rates = rotation.apply(np.column_stack([motion[:, 6:8], flat]))
    speeds = rotation.apply(np.column_stack([motion[:, 9:11] + [0.1, -0.2], flat]))
    sway = rotation.apply(np.column_stack([motion[:, 3:5], flat]))
    assert rows[:, 6:8] == pytest.approx(rates[:, :2])
    assert rows[:, 9:11] == pytest.approx(speeds[:, :2])
    assert rows[:, 3:5] == pytest.approx(place[:, :2] + sway[:, :2])
    assert rows[:, 8] == pytest.approx(0.3)
    assert rows[:, [0, 1, 5, 11]] == pytest.approx(motion[:, [0, 1, 5, 11]])


@pytest.mark.parametrize(
    ("gait", "velocity", "message"),
    [
        ("trot", [0, 0, 0], r"no gait 'trot' \(known: .*stand.*walk"),
        ("walk", [0.2, 0, 0], r"v_x = 0\.2: gait walk reaches \[-0\.0\d+, 0\.0\d+\]"),
        ("walk", [float("nan"), 0, 0], r"v_x = nan: gait walk reaches"),
        ("walk", [0, -0.2, 0], r"v_y = -0\.2: gait walk reaches"),
        ("walk", [0, 0, float("inf")], r"yaw rate = inf: gait walk reaches"),
        ("stand", [0.01, 0, 0], r"v_x = 0\.01: gait stand reaches \[0, 0\]"),
        (
            "walk",
            [0.05, 0, 0.1],
            r"yaw rate = 0\.1: with the other velocities gait walk reaches",
        ),
        (
            "walk",
            [0.06, 0.06, 0],
            r"v_x = 0\.06: with the other velocities gait walk reaches 0\.0",
        ),
        ("walk", [0.05], r"velocity: 1 values, not v_x, v_y, yaw rate"),
    ],
)
def test_an_unknown_gait_or_a_velocity_out_of_range_is_refused(gait, velocity, message):
    with pytest.raises(ConfigError, match=message) as refusal:
        GAITS.require_velocity(gait, np.array(velocity, dtype=float))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("gait", "pose", "message"),
    [
        ("stand", [0.2, 0, 0], r"height = 0\.2: gait stand reaches \[0\.03, 0\.06\]"),
        ("stand", [float("nan"), 0, 0], r"height = nan: gait stand reaches"),
        ("stand", [0.04, 0.2, 0], r"roll = 0\.2: gait stand reaches \[-0\.09, 0\.09\]"),
        ("stand", [0.04, 0, -0.2], r"pitch = -0\.2: gait stand reaches"),
        ("lie", [0.05, 0, 0], "gait lie has slack tendons: no body pose"),
    ],
)
def test_a_body_pose_out_of_range_or_of_slack_legs_is_refused(gait, pose, message):
    with pytest.raises(ConfigError, match=message):
        GAITS.require_pose(gait, np.array(pose))


@pytest.mark.parametrize("gait", ["walk", "fast_walk", "crawl"])
def test_velocities_beyond_the_reached_ones_change_nothing(gait):
    """The patterns scale and clip by themselves, so the limited velocity gives the same angles."""
    stride = GAITS.strides[gait]
    rng, phase = np.random.default_rng(0), np.linspace(0.0, 1.0, 20)
    for _ in range(50):
        asked = rng.uniform(-1.5, 1.5, 3) * stride.speeds
        asked[:2] *= (
            np.hypot(*asked[:2]) > stride.walking_speed
        )  # walking, or turning in place
        given = stride.reached(asked)
        angles = [stride.stride_table(phase, v)[:, :4] for v in (asked, given)]
        if asked[:2].any() or abs(asked[2]) <= stride.turn.speed:
            assert angles[1] == pytest.approx(angles[0], abs=1e-9)
        assert (np.abs(given) <= np.abs(asked) + 1e-12).all()
        assert stride.reached(given) == pytest.approx(given, abs=1e-12)


@pytest.mark.parametrize("kind", [None, "trot", "[1]"])
def test_a_gait_of_an_unknown_kind_is_refused(own_config, kind):
    (own_config / "gait" / "own.yaml").write_text(yaml.safe_dump({"kind": kind}))
    with pytest.raises(
        ConfigError, match=r"gait/own\.yaml: kind = .*expected one of posture"
    ):
        read_gaits()


def test_the_shipped_gaits_are_within_the_robots_limits():
    limit = ROBOT.tendon.angle_max
    assert {"stand", "walk", "sit", "lie"} <= set(GAITS.gaits)
    for stride in GAITS.strides.values():
        assert np.radians(stride.range_deg).max() <= limit
        for velocity in (
            np.zeros(3),
            *np.diag(stride.speeds),
            *-np.diag(stride.speeds),
        ):
            rows = stride_table(velocity, stride=stride)
            assert rows[:, :4].min() >= 0.0
            assert rows[:, :4].max() <= limit
            # over a stride the ground carries the weight; two harmonics miss some of it
            carried = rows[:, 4:8].sum(axis=1).mean()
            assert carried == pytest.approx(ROBOT.weight, rel=0.15)
        assert abs(stride.cruise) <= stride.forward.speed
        assert stride.height_range[0] <= stride.height <= stride.height_range[1]


def test_the_legs_can_carry_every_posture_that_can_be_commanded():
    """At the corners of height, roll and pitch the table has an angle for a quarter of the weight.

    The posture `lie` is not loaded.
    """
    springs = read_springs()
    share = np.full(4, ROBOT.weight / 4)
    for posture in GAITS.postures.values():
        assert isinstance(posture, Posture)
        for height in posture.height_range:
            angle = springs.angle(share, ROBOT.clamp_heights(height, 0.0, 0.0))
            assert angle.max() < ROBOT.tendon.angle_max, (posture, height)
