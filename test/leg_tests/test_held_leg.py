"""Leg with friction at a held clamp against the frictionless leg and Coulomb's law."""

import numpy as np
import pytest
from leg_energy import leg_energy

from slot_core import config
from slot_core.robot import read_robot
from slot_lab.leg_tests.held_leg import HeldLeg
from slot_lab.leg_tests.leg_map import StaticLeg
from slot_lab.leg_tests.level_leg import NoEquilibriumError, at_nodes

# Without damping, a slowly moving leg has the forces of a leg at rest.
ROBOT = config.replace(
    read_robot(), {"leg.damping_time": 0.0, "tendon.cable_damping": 0.0}
)
HEIGHT, RATE = 0.09, np.radians(20.0)


def energy(x, model, angle):
    """Energy of the leg, J, from its free nodes."""
    return leg_energy(model, np.vstack([[0.0, 0.0], x.reshape(-1, 2)]), angle, HEIGHT)


def gradient(x, *rest):
    step = 1e-7 * np.eye(x.size)
    return np.array(
        [(energy(x + d, *rest) - energy(x - d, *rest)) / 2e-7 for d in step]
    )


@pytest.mark.parametrize("angle_deg", [70.0, 90.0, 110.0])
def test_force_without_friction_equals_that_of_the_static_leg(angle_deg):
    leg, rest = HeldLeg(ROBOT, 22, 0.0, HEIGHT), StaticLeg(ROBOT, 22)
    for part in np.linspace(0.0, np.radians(angle_deg), 40):
        expected = rest.solve(part, HEIGHT).force
    # Inertia remains: the force oscillates by some hundredths of a newton after touch-down.
    assert leg.pull(np.radians(angle_deg), RATE) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("friction", [0.1, 0.3])
def test_force_balance_leaves_the_coulomb_friction_of_the_sliding_foot(friction):
    """The energy gradient is zero at free nodes and mu N along the floor at touching nodes."""
    angle, leg = np.radians(100.0), HeldLeg(ROBOT, 12, friction, HEIGHT)
    before = leg.pull(angle - 0.01, RATE), leg.node
    force, node = leg.pull(angle, RATE), leg.node
    slip = (node - before[1])[1:, 0]
    normal = at_nodes(leg.model.floor.stiffness)[1:] * np.maximum(
        0.0, -HEIGHT - node[1:, 1]
    )
    residual = gradient(node[1:].ravel(), leg.model, angle).reshape(-1, 2)
    touching = normal > 0.0
    assert touching.any()
    assert force == pytest.approx(
        normal.sum(), rel=0.01
    )  # the difference is the contact damping
    # The foot slides at about 10 mm/s; the regularisation at 1 mm/s lowers mu N by 0.5 %.
    expected = -friction * normal * np.sign(slip)
    assert residual[touching, 0] == pytest.approx(expected[touching], rel=0.02)
    # N, inertia and contact damping, where the forces are some newtons.
    assert np.abs(residual[~touching]).max() < 0.01
    assert np.abs(residual[:, 1]).max() < 0.02


def test_a_diverged_step_is_an_error_with_angle_and_height():
    leg = HeldLeg(ROBOT, 8, 0.3, HEIGHT)
    leg.model.rod.mass[:] = np.nan
    with pytest.raises(
        NoEquilibriumError, match=r"0\.0900 m: last correction of a node nan m"
    ):
        leg.pull(0.1, RATE)
