"""Legs without and with friction: minima of their energy, Coulomb's law, the standing robot."""

import numpy as np
import pytest
from leg_energy import elastic_energy, strains
from rod_robots import ROBOT, UNDAMPED
from scipy.optimize import minimize

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.legs.leg_table import read_leg_table
from slot_core.simulation.rod_robot import RodRobot
from slot_lab.leg_tests.held_leg import HeldLeg
from slot_lab.leg_tests.leg_map import (
    COLUMNS,
    LegMapSettings,
    StaticLeg,
    tabulate,
)
from slot_lab.leg_tests.level_leg import NoEquilibriumError, at_nodes

HEIGHT, RATE = 0.09, np.radians(20.0)


def leg_energy(model, node, angle, height):
    """Energy of rod, cable, floor and weight of a leg with a routed tendon, J.

    node: (N, 2) m from the clamp, which is at a height (m); angle: of the tendon, rad.
    """
    rod, still = model.rod, np.zeros(len(node) - 1)
    extension, bend = strains(rod, node)
    stored = elastic_energy(model, angle, extension, still, bend, still)
    ends = np.column_stack(
        [node[:-1, 1], node[1:, 1]]
    ).ravel()  # of the segments
    depth = np.minimum(0.0, height + np.repeat(ends, 2))  # both edges touch
    floor = model.floor.stiffness @ depth**2 / 2
    return stored + floor - model.gravity[2] * rod.mass @ node[:, 1]


def pulled(nodes, angle, height, steps=20):
    leg = StaticLeg(ROBOT, nodes)
    for h in np.linspace(0.12, height, steps):
        leg.solve(0.0, h)
    for part in np.linspace(0.0, angle, steps):
        here = leg.solve(part, height)
    return leg, here


def energy(x, model, angle, height):
    """Energy of the leg, J, from its free nodes."""
    return leg_energy(
        model, np.vstack([[0.0, 0.0], x.reshape(-1, 2)]), angle, height
    )


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


@pytest.mark.parametrize(
    ("angle_deg", "height"),
    [(50.0, 0.05), (80.0, 0.05), (100.0, 0.05), (95.0, 0.1)],
)
def test_derivatives_are_difference_quotients(angle_deg, height):
    """Of force, and of the contact, which shifts as the material where the tip alone touches."""
    angle, step = np.radians(angle_deg), 1e-6
    leg, here = pulled(22, angle, height)
    for turn, rise, slopes in (
        (step, 0.0, (here.slope, here.foot_slope)),
        (0.0, step, (here.stiffness, here.foot_rise)),
    ):
        up, down = (
            leg.solve(angle + s * turn, height + s * rise) for s in (1, -1)
        )
        # The force has kinks where a node touches; none within a micrometre of these points.
        change = np.array(
            [up.force - down.force, up.contact_x - down.contact_x]
        )
        count = 2 if height == 0.1 else 1
        assert slopes[:count] == pytest.approx(
            change[:count] / (2 * step), rel=1e-4
        )


def test_standing_robot_has_the_height_at_which_each_leg_carries_a_quarter():
    """Same number of nodes, no friction."""
    smooth = {"floor.friction": [0.0] * 4, "start.settle": 10.0}
    sim = RodRobot(
        ROBOT, config.replace(read_scene("flat"), smooth), read_servo()
    )
    force = pulled(22, sim.tendon_angle[0], sim.position[2])[1].force
    # After ten seconds it still oscillates at 0.03 mm/s: micrometres, at 130 N/m.
    assert force == pytest.approx(ROBOT.weight / 4, rel=1e-4)


def test_shipped_map_matches_the_shipped_robot():
    table = tabulate(ROBOT, config.read(LegMapSettings, "leg_map"))[:, 2:]
    shipped = read_leg_table(COLUMNS[2:]).table.reshape(table.shape)
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


@pytest.mark.parametrize("angle_deg", [70.0, 90.0, 110.0])
def test_force_without_friction_equals_that_of_the_static_leg(angle_deg):
    leg, rest = HeldLeg(UNDAMPED, 22, 0.0, HEIGHT), StaticLeg(UNDAMPED, 22)
    for part in np.linspace(0.0, np.radians(angle_deg), 40):
        expected = rest.solve(part, HEIGHT).force
    # Inertia remains: the force oscillates by some hundredths of a newton after touch-down.
    assert leg.pull(np.radians(angle_deg), RATE) == pytest.approx(
        expected, abs=0.02
    )


@pytest.mark.parametrize("friction", [0.1, 0.3])
def test_force_balance_leaves_the_coulomb_friction_of_the_sliding_foot(
    friction,
):
    """The energy gradient is zero at free nodes and mu N along the floor at touching nodes."""
    angle, leg = np.radians(100.0), HeldLeg(UNDAMPED, 12, friction, HEIGHT)
    before = leg.pull(angle - 0.01, RATE), leg.node
    force, node = leg.pull(angle, RATE), leg.node
    slip = (node - before[1])[1:, 0]
    normal = at_nodes(leg.model.floor.stiffness)[1:] * np.maximum(
        0.0, -HEIGHT - node[1:, 1]
    )
    x, step = node[1:].ravel(), 1e-7 * np.eye(2 * len(slip))
    up, down = (
        [energy(x + s * d, leg.model, angle, HEIGHT) for d in step]
        for s in (1, -1)
    )
    residual = np.subtract(up, down).reshape(-1, 2) / 2e-7
    touching = normal > 0.0
    assert touching.any()
    # the difference is the contact damping
    assert force == pytest.approx(normal.sum(), rel=0.01)
    # The foot slides at about 10 mm/s; the regularisation at 1 mm/s lowers mu N by 0.5 %.
    assert residual[touching, 0] == pytest.approx(
        (-friction * normal * np.sign(slip))[touching], rel=0.02
    )
    # N, inertia and contact damping, where the forces are some newtons.
    assert np.abs(residual[~touching]).max() < 0.01
    assert np.abs(residual[:, 1]).max() < 0.02
