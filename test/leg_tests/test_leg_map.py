"""Static leg against SciPy's minimum of its energy and against the standing robot."""

import csv

import numpy as np
import pytest
from leg_energy import leg_energy
from scipy.optimize import minimize

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.rod_robot import RodRobot
from slot_lab.leg_tests.leg_map import COLUMNS, LegMapSettings, StaticLeg, tabulate
from slot_lab.leg_tests.level_leg import NoEquilibriumError

ROBOT = read_robot()


def pulled(nodes, angle, height, steps=20):
    leg = StaticLeg(ROBOT, nodes)
    for h in np.linspace(0.12, height, steps):
        leg.solve(0.0, h)
    for part in np.linspace(0.0, angle, steps):
        here = leg.solve(part, height)
    return leg, here


def energy(x, model, angle, height):
    """Energy of the leg, J, from its free nodes."""
    return leg_energy(model, np.vstack([[0.0, 0.0], x.reshape(-1, 2)]), angle, height)


def test_equilibrium_is_a_minimum_of_the_energy():
    angle, height = np.radians(70.0), 0.05
    leg, here = pulled(7, angle, height)
    found = minimize(
        energy,
        1.02 * here.node[1:].ravel(),
        (leg.model, angle, height),
        tol=1e-14,
        method="BFGS",
    )
    # BFGS with difference gradients stops at 1e-8 of the gradient, about 1e-5 m from the minimum.
    np.testing.assert_allclose(found.x.reshape(-1, 2), here.node[1:], atol=3e-5)


def test_a_leg_loaded_in_its_plane_stays_in_it_to_the_last_bit():
    leg, _ = pulled(22, np.radians(100.0), 0.05)
    assert not leg._leg.stage[:, 1].any()
    assert not leg._leg.spin.any()


@pytest.mark.parametrize("angle_deg", [50.0, 80.0, 100.0])
def test_slope_and_stiffness_are_the_difference_quotients_of_the_force(angle_deg):
    angle, height, step = np.radians(angle_deg), 0.05, 1e-6
    leg, here = pulled(22, angle, height)
    up, down = (
        leg.solve(angle + step, height).force,
        leg.solve(angle - step, height).force,
    )
    assert here.slope == pytest.approx((up - down) / (2 * step), rel=1e-4)
    up, down = (
        leg.solve(angle, height + step).force,
        leg.solve(angle, height - step).force,
    )
    # The force has kinks where a node touches; none within a micrometre of these points.
    assert here.stiffness == pytest.approx((up - down) / (2 * step), rel=1e-4)


def test_material_and_contact_shift_alike_on_the_tip():
    angle, height, step = np.radians(95.0), 0.1, 1e-6
    leg, here = pulled(22, angle, height)
    up, down = leg.solve(angle + step, height), leg.solve(angle - step, height)
    assert here.foot_slope == pytest.approx(
        (up.contact_x - down.contact_x) / (2 * step), rel=1e-4
    )
    up, down = leg.solve(angle, height + step), leg.solve(angle, height - step)
    assert here.foot_rise == pytest.approx(
        (up.contact_x - down.contact_x) / (2 * step), rel=1e-4
    )


def test_material_and_contact_shift_oppositely_where_the_leg_rolls():
    angle, step = np.radians(63.0), 1e-3
    leg, here = pulled(61, angle, 0.03)
    up, down = leg.solve(angle, 0.03 + step), leg.solve(angle, 0.03 - step)
    assert (up.contact_x - down.contact_x) / (
        2 * step
    ) > 0.2  # the contact moves outward
    assert here.foot_rise < -0.1  # the material on the floor moves inward


def test_standing_robot_has_the_height_at_which_each_leg_carries_a_quarter():
    """Same number of nodes, no friction."""
    smooth = {"floor.friction": [0.0] * 4, "start.settle": 10.0}
    sim = RodRobot(ROBOT, config.replace(read_scene("flat"), smooth), read_servo())
    force = pulled(22, sim.tendon_angle[0], sim.position[2])[1].force
    # After ten seconds it still oscillates at 0.03 mm/s: micrometres, at 130 N/m.
    assert force == pytest.approx(ROBOT.weight / 4, rel=1e-4)


def test_shipped_map_matches_the_shipped_robot():
    settings = config.read(LegMapSettings, "leg_map")
    with (config.config_dir() / "leg_map.csv").open() as file:
        names, *rows = csv.reader(file)
    assert tuple(names) == COLUMNS
    shipped, table = np.array(rows, dtype=float), tabulate(ROBOT, settings)
    # Six digits are written. Rounding may change whether a node touches: allow for a few rows.
    same = np.isclose(shipped, table, rtol=1e-4, atol=1e-6).all(axis=1)
    assert same.mean() > 0.99


def test_no_equilibrium_is_an_error_with_angle_and_height():
    leg = StaticLeg(ROBOT, 10)
    leg._leg.stage[:] = np.nan
    with pytest.raises(NoEquilibriumError, match=r"20\.000 deg, 0\.0500 m"):
        leg.solve(np.radians(20.0), 0.05)


def test_a_leg_above_the_floor_has_no_force():
    _, here = pulled(22, 0.0, 0.12)
    assert (here.force, here.slope, here.stiffness, here.tension) == (
        0.0,
        0.0,
        0.0,
        0.0,
    )
