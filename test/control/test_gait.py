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
from slot_core.gait.gait import (
    FRONT_REAR,
    LEFT_RIGHT,
    places_ahead,
    read_gaits,
    reference,
)
from slot_core.robot import read_robot
from slot_core.simulation.make_robot import make_robot

ROBOT, GAITS = read_robot(), read_gaits()
WALK = GAITS.strides["walk"]
PHASES = np.linspace(0.0, 1.0, 41)[:-1]
# Signs of roll, pitch, yaw, p, omega, v under the reflection of x, and under that of y.
REFLECTED_X = np.array([1, -1, -1, -1, 1, 1, 1, -1, -1, -1, 1, 1], dtype=float)
REFLECTED_Y = np.array([-1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1], dtype=float)


def stride_table(velocity, phase=PHASES, stride=WALK, offset=0.0):
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
        speed = {
            name: tuple(1e-2 * rng.normal(size=5)) for name in ("v_x", "v_y")
        }
        load = tuple(map(tuple, 0.1 * rng.normal(size=(4, 5))))
        angle = tuple(map(tuple, size * np.array(pattern.angle_deg)))
        return dataclasses.replace(
            pattern, angle_deg=angle, normal_force=load, **motion, **speed
        )

    patterns = {
        name: table(getattr(WALK, name))
        for name in ("forward", "lateral", "turn")
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


def test_amplitudes_are_proportional_to_the_velocity_and_directions_add_up():
    def deviation(*velocity):
        return stride_table(velocity, stride=stride) - centre

    stride, centre = filled(), 0.0
    centre = deviation(0, 0, 0)
    forward, lateral = deviation(0.03, 0, 0), deviation(0, -0.02, 0)
    assert deviation(0.015, 0, 0) == pytest.approx(forward / 2, abs=1e-12)
    assert deviation(0.03, -0.02, 0) == pytest.approx(
        forward + lateral, abs=1e-12
    )
    for yaw_rate in (0.02, -0.02):  # steering
        two = deviation(0.03, 0, yaw_rate) - forward
        one = deviation(0.03, 0, yaw_rate / 2) - forward
        assert two == pytest.approx(2 * one, abs=1e-12)
        assert np.abs(one[:, :4]).max() > 1e-3


def test_amplitudes_are_bounded_by_an_ellipsoid():
    stride = dataclasses.replace(filled(), amplitude_max=(1.0, 0.5, 1.0))
    ahead, aside = stride.forward.speed, stride.lateral.speed
    share = 1 / math.sqrt(2)
    within = [share * ahead, share * aside / 2, 0], [0, aside / 2, 0]
    for beyond, reached in zip(([ahead, aside / 2, 0], [0, 0.2, 0]), within):
        table = stride_table(beyond, stride=stride)
        assert table == pytest.approx(stride_table(reached, stride=stride))


def test_offsets_shift_the_angles_within_the_range():
    offsets, stride = np.radians([0.0, 5.0, -5.0, 90.0, -90.0]), filled()
    plain, *shifted = (
        stride_table([0.05, 0, 0], stride=stride, offset=offset)[:, :4]
        for offset in offsets
    )
    assert np.array(shifted) == pytest.approx(
        np.clip(plain + offsets[1:, None, None], *np.radians(stride.range_deg)),
        abs=1e-12,
    )


def test_rates_and_velocities_of_the_torso_are_the_derivatives_of_its_angles_and_sway():
    stride, h = filled(), 1e-6
    for velocity in ([0.05, 0, 0], [0.03, -0.03, 0.0], [0, 0, 0.1]):
        before, now, after = (
            stride_table(velocity, PHASES + d, stride)[:, 8:]
            for d in (-h, 0, h)
        )
        slope = (after - before) / (2 * h * stride.period)
        assert now[:, [6, 7, 11]] == pytest.approx(
            slope[:, [0, 1, 5]], abs=1e-7
        )
        about_mean = now[:, [9, 10]] - now[:, [9, 10]].mean(axis=0)
        assert about_mean == pytest.approx(slope[:, [3, 4]], abs=1e-7)
        assert now[:, [3, 4]].mean(axis=0) == pytest.approx(
            np.zeros(2), abs=1e-12
        )


MIRRORS = {
    "backward": ([0.05, 0, 0], [-0.05, 0, 0], FRONT_REAR, REFLECTED_X),
    "to the right": ([0, 0.05, 0], [0, -0.05, 0], LEFT_RIGHT, REFLECTED_Y),
    "turning right": ([0, 0, 0.1], [0, 0, -0.1], LEFT_RIGHT, REFLECTED_Y),
    "a right-hand bend": (
        [0.05, 0, 0.03],
        [0.05, 0, -0.03],
        LEFT_RIGHT,
        REFLECTED_Y,
    ),
    "a bend backward": (
        [0.05, 0, 0.03],
        [-0.05, 0, -0.03],
        FRONT_REAR,
        REFLECTED_X,
    ),
}


@pytest.mark.parametrize(
    "case", [c for c in MIRRORS if c != "a right-hand bend"]
)
def test_the_opposite_velocity_is_the_mirror_image_half_a_stride_later(case):
    velocity, opposite, legs, signs = MIRRORS[case]
    stride = filled()
    angle, force, motion = np.split(
        stride_table(velocity, (PHASES + 0.5) % 1.0, stride), [4, 8], axis=1
    )
    expected = np.hstack([angle[:, legs], force[:, legs], signs * motion])
    back = stride_table(opposite, PHASES, stride)
    assert back == pytest.approx(expected, abs=1e-12)


def state_after(velocity, phase, duration=2.8):
    """State (12,) of the simulated robot on the flat floor, open loop, new angles every 30 ms."""
    sim = make_robot(ROBOT, read_scene("flat"), read_servo())
    for time in np.arange(0.0, duration, 0.03):
        at = np.array([(phase + time / WALK.period) % 1.0])
        sim.advance(30, stride_table(velocity, at)[0, :4])
    return np.concatenate(
        [sim.rpy, sim.position, sim.angular_velocity, sim.velocity]
    )


@pytest.mark.parametrize("case", ["backward", "a right-hand bend"])
def test_the_simulated_robot_moves_with_the_opposite_velocity_in_the_mirror_image(
    case,
):
    """Four strides from rest; the robot, the floor and its numerics are symmetric.

    A bend to the right is the mirror image of one to the left only for a pattern that is symmetric
    itself: the forward pattern is, half a stride later.
    """
    velocity, opposite, _, signs = MIRRORS[case]
    there, back = state_after(velocity, 0.5), state_after(opposite, 0.0)
    assert np.abs(there[2:5]).max() > 0.02  # it has moved, or turned
    np.testing.assert_allclose(back, signs * there, rtol=0, atol=1e-9)


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.0])
def test_places_ahead_move_with_the_velocity_in_the_direction_of_the_heading(
    heading,
):
    """A circle of 0.2 m, by steps of the velocity."""
    turning = np.tile([0.1, 0.0, 0.5], (200, 1))
    places = places_ahead(np.array([1.0, 2.0, heading]), turning, 0.001)
    yaw = heading + 0.0005 * np.arange(200)
    x = 1.0 + 0.2 * (np.sin(yaw) - np.sin(heading))
    y = 2.0 + 0.2 * (np.cos(heading) - np.cos(yaw))
    np.testing.assert_allclose(places, np.column_stack([x, y, yaw]), atol=1e-5)


@pytest.mark.parametrize(
    ("heading", "yaw"), [(3.1, -3.1), (-3.1, 3.1), (9.0, 2.6), (0.2, 0.3)]
)
def test_the_reference_is_within_half_a_turn_of_the_state(heading, yaw):
    state, still = yaw * np.eye(12)[2], np.zeros((1, 3))
    rows = reference(
        state, np.array([[0.0, 0.0, heading]]), still, np.zeros((1, 12))
    )
    assert abs(rows[0, 2] - yaw) < np.pi
    assert np.exp(1j * rows[0, 2]) == pytest.approx(np.exp(1j * heading))


def test_sway_rotates_with_the_heading():
    """v = [v_x, v_y], omega and the sway of x and y, rotated by yaw, are vectors in odom."""
    rng = np.random.default_rng(0)
    motion, place = rng.normal(size=(5, 12)), rng.normal(size=(5, 3))
    velocity = np.tile([0.1, -0.2, 0.3], (5, 1))
    rows = reference(np.zeros(12), place, velocity, motion)
    rotation, expected = Rotation.from_euler("z", place[:, 2:3]), motion.copy()
    for first, added in ((6, 0.0), (9, velocity[:, :2]), (3, 0.0)):
        vector = np.zeros((5, 3))
        vector[:, :2] = motion[:, first : first + 2] + added
        expected[:, first : first + 2] = rotation.apply(vector)[:, :2]
    expected[:, 3:5] += place[:, :2]
    expected[:, [2, 8]] = np.column_stack([place[:, 2], velocity[:, 2]])
    assert rows == pytest.approx(expected)


@pytest.mark.parametrize(
    ("require", "gait", "values", "message"),
    [
        (
            "velocity",
            "trot",
            [0, 0, 0],
            r"no gait 'trot' \(known: .*stand.*walk",
        ),
        (
            "velocity",
            "walk",
            [0.2, 0, 0],
            r"v_x = 0\.2: gait walk reaches \[-0\.0\d+, 0",
        ),
        ("velocity", "walk", [np.nan, 0, 0], r"v_x = nan: gait walk reaches"),
        (
            "velocity",
            "walk",
            [0, 0, np.inf],
            r"yaw rate = inf: gait walk reaches",
        ),
        (
            "velocity",
            "stand",
            [0.01, 0, 0],
            r"v_x = 0\.01: gait stand reaches \[0, 0\]",
        ),
        (
            "velocity",
            "walk",
            [0.05, 0, 0.1],
            r"yaw rate = 0\.1: with the other velocities gait walk reaches",
        ),
        (
            "velocity",
            "walk",
            [0.06, 0.06, 0],
            r"v_x = 0\.06: with the other velocities gait walk reaches 0\.0",
        ),
        (
            "velocity",
            "walk",
            [0.05],
            r"velocity: 1 values, not v_x, v_y, yaw rate",
        ),
        (
            "pose",
            "stand",
            [0.2, 0, 0],
            r"height = 0\.2: gait stand reaches \[0\.03, 0\.06",
        ),
        ("pose", "stand", [np.nan, 0, 0], r"height = nan: gait stand reaches"),
        (
            "pose",
            "stand",
            [0.04, 0.2, 0],
            r"roll = 0\.2: gait stand reaches \[-0\.09, 0",
        ),
        (
            "pose",
            "lie",
            [0.05, 0, 0],
            "gait lie has slack tendons: no body pose",
        ),
    ],
)
def test_an_unknown_gait_and_a_velocity_or_a_pose_out_of_range_are_refused(
    require, gait, values, message
):
    with pytest.raises(ConfigError, match=message) as refusal:
        getattr(GAITS, f"require_{require}")(
            gait, np.array(values, dtype=float)
        )
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("gait", ["walk", "fast_walk", "crawl"])
def test_velocities_beyond_the_reached_ones_change_nothing(gait):
    """The patterns scale and clip by themselves, so the limited velocity gives the same angles."""
    stride, rng = GAITS.strides[gait], np.random.default_rng(0)
    for _ in range(50):
        asked = rng.uniform(-1.5, 1.5, 3) * stride.speeds
        # walking, or turning in place
        asked[:2] *= np.hypot(*asked[:2]) > stride.walking_speed
        given = stride.reached(asked)
        angles = [stride_table(v, stride=stride)[:, :4] for v in (asked, given)]
        if asked[:2].any() or abs(asked[2]) <= stride.turn.speed:
            assert angles[1] == pytest.approx(angles[0], abs=1e-9)
        assert (np.abs(given) <= np.abs(asked) + 1e-12).all()
        assert stride.reached(given) == pytest.approx(given, abs=1e-12)


@pytest.mark.parametrize("kind", [None, "trot", "[1]"])
def test_a_gait_of_an_unknown_kind_is_refused(own_config, kind):
    (own_config / "gait" / "own.yaml").write_text(
        yaml.safe_dump({"kind": kind})
    )
    with pytest.raises(
        ConfigError, match=r"gait/own\.yaml: kind = .*expected one of posture"
    ):
        read_gaits()


def test_the_legs_can_carry_every_posture_that_can_be_commanded():
    """At the ends of height the table has an angle for a quarter of the weight."""
    springs, share = read_springs(), np.full(4, ROBOT.weight / 4)
    for posture in GAITS.postures.values():
        for height in posture.height_range:
            angle = springs.angle(share, ROBOT.clamp_heights(height, 0.0, 0.0))
            assert angle.max() < ROBOT.tendon.angle_max, (posture, height)
