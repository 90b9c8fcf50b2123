"""Force map: tendon angles from ground reaction forces."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.control.force_map import ForceMap, make_force_map, read_force_map
from slot_core.gait.gait import GaitCommand, GaitPreview
from slot_core.legs.leg_springs import LegSprings
from slot_core.legs.leg_table import LegTable
from slot_core.robot import read_robot

ROBOT = read_robot()
HEIGHT = 0.06
THETA = np.radians([0.0, 60.0, 120.0])
HEIGHTS = np.array([0.02, 0.06, 0.10])
SLOPES = np.array([[5.0, 6.0, 7.0], [8.0, 9.0, 10.0], [11.0, 12.0, 13.0]])
STIFFNESS = -100.0  # N/m
MAPS = ("springs", "incremental", "paper")


def preview(angle_deg=60.0, load=5.3, posture=True):
    shape = (15, 4)
    reference = np.zeros((15, 12))
    reference[:, 5] = HEIGHT
    return GaitPreview(
        stamp=0,
        gait="stand",
        phase=0.0,
        period=1.0,
        dt=0.033,
        contact=np.ones(shape, bool),
        friction=np.full(shape, 0.4),
        normal_force=np.full(shape, load),
        tendon_angle=np.full(shape, np.radians(angle_deg)),
        reference=reference,
        posture=posture,
        command=GaitCommand("stand", np.zeros(3), np.array([HEIGHT, 0.0, 0.0])),
    )


def forces(*normal):
    return np.column_stack([np.zeros((4, 2)), normal])


def state(height=HEIGHT, rpy=(0, 0, 0)):
    x = np.zeros(12)
    x[0:3], x[5] = rpy, height
    return x


def mapped(force_map, force, demand, torso):
    return force_map.step(force, force_map.nominal(demand, torso))


@pytest.fixture
def make():
    table = np.zeros((3, 3, 4))  # force, slope, stiffness, contact
    table[..., 1], table[..., 2] = SLOPES, STIFFNESS

    def build(name, **changes):
        settings = config.replace(read_force_map(), changes)
        springs = LegSprings(LegTable(THETA, HEIGHTS, table), settings.slope_min)
        return ForceMap(ROBOT, settings, name, springs)

    return build


def test_the_paper_map_is_the_line_of_the_paper(make):
    command = mapped(make("paper"), forces(0.0, 2.0, 4.0, 5.0), preview(), state())
    expected = (np.array([0.0, 2.0, 4.0, 5.0]) + 6.91) / 0.107
    assert np.degrees(command.angle) == pytest.approx(expected)
    assert not command.saturated.any()


def test_the_paper_map_saturates_at_the_limit_of_the_servo(make):
    """6 N, the paper's bound, needs 120.65 deg; the servo's limit of 116.28 deg is 5.532 N."""
    command = mapped(make("paper"), forces(5.53, 5.54, 6.0, 1.0), preview(), state())
    assert command.saturated.tolist() == [False, True, True, False]
    assert command.angle[1:3] == pytest.approx(ROBOT.tendon.angle_max)
    assert np.degrees(command.angle_unclamped[2]) == pytest.approx(120.65, abs=0.01)


@pytest.mark.parametrize("name", ["springs", "incremental"])
def test_the_normal_force_of_the_gait_gives_its_nominal_angle(make, name):
    command = mapped(make(name), forces(5.3, 5.3, 5.3, 5.3), preview(), state())
    assert np.degrees(command.angle) == pytest.approx(60.0)


@pytest.mark.parametrize("name", ["springs", "incremental"])
def test_a_deviation_is_divided_by_the_slope_at_angle_and_height(make, name):
    command = mapped(make(name), forces(5.3, 5.8, 4.8, 6.3), preview(), state())
    assert command.slope == pytest.approx(9.0)
    assert command.angle - np.radians(60) == pytest.approx(np.array([0, 0.5, -0.5, 1.0]) / 9.0)


def test_the_incremental_slope_is_that_at_the_clamp_height_of_a_tilted_torso(make):
    rpy = (0.05, -0.08, 0.7)
    command = mapped(make("incremental"), forces(*[5.3] * 4), preview(), state(HEIGHT, rpy))
    rotation = Rotation.from_euler("ZYX", rpy[::-1]).as_matrix()
    heights = HEIGHT + (ROBOT.clamps @ rotation.T)[:, 2]
    assert command.slope == pytest.approx(9.0 + (heights - 0.06) / 0.04)


def test_a_spring_that_is_too_high_is_wound_by_the_force_that_it_has_lost(make):
    """f = f_gait + F_theta (theta - theta_gait) + F_h (h - h_ref), at the angle that is returned.

    10 mm too high, a spring of -100 N/m lacks 1 N, and the slope at the reference is 9 N/rad.
    """
    wanted = np.array([5.3, 5.8, 4.8, 6.3])
    command = mapped(make("springs"), forces(*wanted), preview(), state(HEIGHT + 0.01))
    turned = command.angle - np.radians(60)
    assert 5.3 + 9.0 * turned + STIFFNESS * 0.01 == pytest.approx(wanted)


def test_the_legs_of_a_stride_are_no_springs_at_rest(make):
    """Their height swings with the stride: a difference from the reference is no error."""
    walking = preview(posture=False)
    command = mapped(make("springs"), forces(*[5.3] * 4), walking, state(HEIGHT + 0.01))
    assert np.degrees(command.angle) == pytest.approx(60.0)


def test_a_leg_out_of_contact_keeps_the_angle_of_the_gait(make):
    contact = np.ones((15, 4), dtype=bool)
    contact[0, 2] = False
    lifted = dataclasses.replace(preview(), contact=contact)
    command = mapped(make("springs"), forces(6.2, 6.2, 0.0, 6.2), lifted, state())
    assert command.angle[2] == np.radians(60.0)
    assert command.angle[[0, 1, 3]] == pytest.approx(np.radians(60.0) + 0.1)


def test_the_incremental_correction_is_bounded(make):
    bounded = make("incremental", correction_max_deg=10.0)
    command = mapped(bounded, forces(0, 50, 5.3, 5.3), preview(), state())
    assert np.degrees(command.angle) == pytest.approx([50.0, 70.0, 60.0, 60.0])


@pytest.mark.parametrize("name", MAPS)
def test_angles_stay_within_their_limits_for_any_force(make, name):
    rng = np.random.default_rng(1)
    force_map, limit = make(name, correction_max_deg=120.0), ROBOT.tendon.angle_max
    for _ in range(200):
        demand = preview(rng.uniform(0, 116))
        command = mapped(
            force_map, forces(*rng.normal(5, 20, 4)), demand, state(rng.uniform(0, 0.2))
        )
        assert command.angle.min() >= 0.0
        assert command.angle.max() <= limit
        assert (command.saturated == (command.angle != command.angle_unclamped)).all()


@pytest.mark.parametrize("name", MAPS)
def test_hold_repeats_the_last_angles(make, name):
    force_map = make(name)
    assert np.degrees(force_map.hold(preview(70.0)).angle) == pytest.approx(70.0)
    last = mapped(force_map, forces(5.0, 5.3, 5.1, 4.9), preview(), state())
    held = force_map.hold(preview(70.0))
    assert held.map == "hold"
    assert (held.angle == last.angle).all()


def test_the_shipped_table_has_the_slope_of_the_robots_stance():
    """About 0.177 N/deg at 63 deg and 40 mm. The bound is coarse; the table has its own test."""
    force_map = make_force_map(ROBOT, read_force_map(), "incremental")
    slope = force_map.nominal(preview(63.0), state(0.04)).slope
    assert np.radians(slope) == pytest.approx(0.177, rel=0.25)


@pytest.mark.parametrize("name", MAPS)
def test_a_command_goes_on_at_the_rate_of_the_gait_but_for_the_papers(make, name):
    demand = preview()
    demand.tendon_angle[1] += 0.033 * np.array([1.0, -2.0, 0.5, 0.0])
    command = mapped(make(name), forces(*[5.3] * 4), demand, state())
    wanted = [0.0] * 4 if name == "paper" else [1.0, -2.0, 0.5, 0.0]
    assert command.rate == pytest.approx(wanted)
    assert make(name).hold(demand).rate.tolist() == [0.0] * 4
