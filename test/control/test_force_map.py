"""Force map: tendon angles of plans, with angles and of forces alone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.mpc.cases import standing, state
from slot_core import config
from slot_core.control.force_map import (
    ForceMap,
    make_force_map,
    read_force_map,
)
from slot_core.control.policy import Status, TendonPlan
from slot_core.legs.leg_table import LegSprings, LegTable
from slot_core.robot import read_robot

ROBOT = read_robot()
HEIGHT = 0.06
LEVEL = state(p=(0, 0, HEIGHT))
THETA = np.radians([0.0, 60.0, 120.0])
HEIGHTS = np.array([0.02, 0.06, 0.10])
SLOPES = np.array([[5.0, 6.0, 7.0], [8.0, 9.0, 10.0], [11.0, 12.0, 13.0]])


def preview(angle_deg=60.0):
    angle = np.full((15, 4), np.radians(angle_deg))
    return standing(15, normal_force=np.full((15, 4), 5.3), tendon_angle=angle)


def of_forces(name, *normal, status=Status.SOLVED):
    """A plan of normal forces (4,) N alone."""
    force = np.zeros((1, 4, 3))
    force[0, :, 2] = normal
    return TendonPlan(np.zeros((0, 4)), np.zeros(4), force, status, map=name)


def make(**changes):
    table = np.zeros((3, 3, 4))  # force, slope, stiffness, contact
    table[..., 1] = SLOPES
    settings = config.replace(read_force_map(), changes)
    springs = LegSprings(LegTable(THETA, HEIGHTS, table), settings.slope_min)
    return ForceMap(ROBOT, settings, springs)


def test_planned_angles_and_rates_are_passed_on_and_clipped_beyond_the_limit():
    angle = np.array([[-0.1, 0.5, 3.0, 1.0], [0.4, 1.2, 2.0, 0.1]])
    plan = TendonPlan(angle, np.arange(4.0), np.ones((2, 4, 3)))
    command = make().step(plan, preview(), LEVEL)
    assert command.map == "planned"
    assert command.angle.tolist() == [0.0, 0.5, ROBOT.tendon.angle_max, 1.0]
    assert command.saturated.tolist() == [True, False, True, False]
    np.testing.assert_array_equal(command.rate, plan.rate)


def test_a_deviation_from_the_force_of_the_gait_is_divided_by_the_slope():
    """The slope at the clamps' heights of a tilted torso; the rate is the gait's."""
    rpy, demand = (0.05, -0.08, 0.7), preview()
    demand.tendon_angle[1] += 0.033 * np.array([1.0, -2.0, 0.5, 0.0])
    plan = of_forces("incremental", 5.3, 5.8, 4.8, 6.3)
    command = make().step(plan, demand, state(rpy, (0, 0, HEIGHT)))
    rotation = Rotation.from_euler("ZYX", rpy[::-1]).as_matrix()
    heights = HEIGHT + (ROBOT.clamps @ rotation.T)[:, 2]
    assert command.slope == pytest.approx(9.0 + (heights - 0.06) / 0.04)
    correction = np.array([0, 0.5, -0.5, 1.0]) / command.slope
    assert command.angle - np.radians(60) == pytest.approx(correction)
    assert command.rate == pytest.approx([1.0, -2.0, 0.5, 0.0])


def test_the_incremental_correction_is_bounded():
    plan = of_forces("incremental", 0, 50, 5.3, 5.3)
    command = make(correction_max_deg=10.0).step(plan, preview(), LEVEL)
    assert np.degrees(command.angle) == pytest.approx([50.0, 70.0, 60.0, 60.0])


def test_a_plan_that_has_stopped_holds_the_last_angles():
    force_map, lifted = make(), preview(70.0)
    stopped = of_forces(
        "incremental", 1.0, 2.0, 3.0, 4.0, status=Status.STOPPED
    )
    first = force_map.step(stopped, lifted, LEVEL)
    assert np.degrees(first.angle) == pytest.approx(70.0)
    solved = of_forces("incremental", 5.0, 5.3, 5.1, 4.9)
    last = force_map.step(solved, preview(), LEVEL)
    held = force_map.step(stopped, lifted, LEVEL)
    assert (held.map, held.angle.tolist()) == ("hold", last.angle.tolist())
    assert held.rate.tolist() == [0.0] * 4


def test_an_unknown_map_is_refused():
    with pytest.raises(ValueError, match="map 'cubic': expected incremental"):
        make().step(of_forces("cubic", *[5.3] * 4), preview(), LEVEL)


def test_an_angle_is_moved_on_at_its_rate_from_the_tick_to_the_sample_that_led_to_it():
    """The state is predicted by the delay beyond it; the angle is within its range as before."""
    late = make_force_map(ROBOT, read_force_map(), delay=0.0025)
    rate = np.array([1.0, -2.0, 0.0, 4.0])
    angle = np.array([0.5, 0.6, 0.7, ROBOT.tendon.angle_max])
    plan = TendonPlan(angle[None], rate, np.ones((1, 4, 3)))
    at_tick = late.step(plan, preview(), LEVEL, 2_500_000)
    np.testing.assert_array_equal(at_tick.angle, angle)
    later = late.step(plan, preview(), LEVEL, 6_500_000)
    moved = [0.504, 0.592, 0.7, ROBOT.tendon.angle_max]
    np.testing.assert_allclose(later.angle, moved, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(later.rate, rate)
