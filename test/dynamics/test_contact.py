"""Contact with the floor compared with Coulomb's law.

Height maps compared with SciPy's interpolation and with an inclined plane.
"""

import numpy as np
import pytest
from leg_energy import robot_momentum
from numba import njit
from rod_robots import ROBOT, simulator
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.dynamics.algebra import add, scaled
from slot_core.dynamics.contact import (
    RELEASING,
    Terrain,
    advance_bristle,
    coefficient,
    friction_force,
    ground,
)
from slot_core.dynamics.model import build_floor
from slot_core.dynamics.rod import discretise
from slot_core.dynamics.scene import read_scene
from slot_core.robot import GRAVITY
from slot_lab.leg_tests.level_leg import at_nodes

ROD, WIDTH = (
    discretise(ROBOT.leg, 22, ROBOT.tendon.end_fraction),
    ROBOT.leg.contact_width,
)
MU, STIFFNESS, DAMPING = 0.4, 2e4, 5.0


def floor(**changes):
    """The floor of the scene `flat` with changed settings."""
    changes = {f"floor.{name}": value for name, value in changes.items()}
    return build_floor(
        config.replace(read_scene("flat"), changes).floor, ROD, WIDTH
    )


@njit
def drag_along(floor, path, limit, slope, h):
    """Bristles (n, 3) of a point with velocities (n, 3), each for a time h; limits mu N (n,)."""
    bristle, out = np.zeros(3), np.zeros((len(path), 3))
    for i in range(len(path)):
        advance_bristle(floor, bristle, limit[i], STIFFNESS, slope, h, path[i])
        out[i] = bristle
    return out


@njit
def force_at(floor, limit, tau, bristle, v):
    hold = friction_force(floor, limit, tau, STIFFNESS, DAMPING, bristle, v)
    x, y, z = add(scaled(hold.drag, v), hold.held)
    return np.array([x, y, z])


FLAT = np.zeros(2)


def test_a_bristle_on_a_line_is_a_spring_in_series_with_a_coulomb_slider():
    """Prandtl's element: each increment of the spring's force stops at the yield force."""
    law, h, rng = (
        floor(friction_law="bristle", bristle=0.7),
        1e-3,
        np.random.default_rng(3),
    )
    speed = np.repeat(rng.normal(0.0, 0.1, 40), 25)
    normal = np.repeat(rng.uniform(1.0, 20.0, 20), 50)
    path = np.outer(speed, [0.6, 0.8, 0.0])
    held = drag_along(law, path, MU * normal, FLAT, h) @ [0.6, 0.8, 0.0]
    spring, expected = 0.0, []
    for v, n in zip(speed, normal):
        spring += 0.7 * STIFFNESS * v * h
        spring = max(-MU * n, min(MU * n, spring))
        expected.append(spring)
    np.testing.assert_allclose(
        0.7 * STIFFNESS * held, expected, atol=1e-12 * STIFFNESS
    )
    slipping = np.abs(expected) == MU * normal
    assert 0.1 < slipping.mean() < 0.9  # both regimes occur


def test_a_bristle_aligns_with_the_slip_and_its_force_stays_within_mu_n():
    law, rng = floor(friction_law="bristle"), np.random.default_rng(4)
    path = np.column_stack([rng.normal(0.0, 0.3, (2000, 2)), np.zeros(2000)])
    path[-500:] = [0.03, -0.04, 0.0]  # slips in the end
    limit = MU * rng.uniform(0.0, 20.0, 2000)
    limit[-500:] = MU * 10.0
    held = drag_along(law, path, limit, FLAT, 1e-3)
    force = STIFFNESS * np.linalg.norm(held, axis=1)
    assert (force <= limit * (1 + 1e-12)).all()
    np.testing.assert_allclose(
        STIFFNESS * held[-1], MU * np.array([6.0, -8.0, 0.0]), rtol=1e-9
    )
    for bristle, v, most in zip(held, path, limit):
        # including its growth within the step
        now = force_at(law, most, 5.5e-4, bristle, v)
        assert np.linalg.norm(now) <= most * (1 + 1e-12)


def test_a_sticking_bristle_is_a_spring_and_a_damper():
    law = floor(friction_law="bristle", bristle=0.5)
    bristle, v, tau = (
        np.array([1e-4, -2e-4, 0.0]),
        np.array([0.01, 0.02, 0.0]),
        5e-4,
    )
    expected = 0.5 * (STIFFNESS * (bristle + tau * v) + DAMPING * v)
    np.testing.assert_allclose(
        force_at(law, 1e3, tau, bristle, v), expected, rtol=1e-12
    )


def test_a_bristle_lies_in_the_plane_of_the_floor():
    """A point moves along and into a plane of slopes (0.3, -0.2): only the motion along counts."""
    slope = np.array([0.3, -0.2])
    up = np.array([-0.3, 0.2, 1.0]) / np.sqrt(1.13)
    along = np.cross(up, [0.0, 1.0, 0.0])
    path = np.tile(0.02 * along - 0.5 * up, (100, 1))
    held = drag_along(
        floor(friction_law="bristle"), path, np.full(100, 1e6), slope, 1e-3
    )
    np.testing.assert_allclose(held[-1], 0.1 * 0.02 * along, atol=1e-15)


@njit
def factor(floor, own, other, rate, v, slip):  # noqa: PLR0917
    return coefficient(floor, own, other, rate, v, slip)


def test_friction_depends_on_the_direction_of_slip_or_on_the_release_of_the_tendon():
    """By direction it blends: at the slip speed eps it has reached 1 / sqrt(2)."""
    by_direction, by_phase = (
        floor(friction_varies=kind) for kind in ("direction", "phase")
    )
    eps = by_direction.friction_velocity
    middle = 0.35 - 0.25 / np.sqrt(2)
    # outward and total speed of the slip, m/s
    for outward, speed, expected in [
        (-10.0, 10.0, 0.6),
        (10.0, 10.0, 0.1),
        (0.0, 0.0, 0.35),
        (0.0, 10.0, 0.35),
        (eps, eps, middle),
    ]:
        assert factor(
            by_direction, 0.6, 0.1, 0.0, outward, speed**2
        ) == pytest.approx(expected, rel=1e-6)
    for rate, expected in [
        (1.0, 0.6),
        (0.0, 0.6),
        (0.9 * RELEASING, 0.6),
        (-1.0, 0.2),
    ]:
        assert factor(by_phase, 0.6, 0.2, rate, 0.3, 0.09) == expected
    # uniform: no effect
    assert factor(floor(), 0.6, 0.2, -1.0, 0.3, 0.09) == 0.6


def inclined(degrees):
    """A settled start on an incline, with bristle friction."""
    slope = np.radians(degrees)
    gravity = [-GRAVITY * np.sin(slope), 0.0, -GRAVITY * np.cos(slope)]
    return {
        "gravity": gravity,
        "start__settle": 2.0,
        "floor__friction_law": "bristle",
    }


def test_bristles_hold_below_the_friction_angle_without_creep():
    """20 deg with friction 0.4; sliding begins at 21.8 deg."""
    sim = simulator(**inclined(20.0))
    # until the legs' oscillation has decayed
    sim.advance(3000, sim.tendon_angle)
    x = sim.position
    sim.advance(10000, sim.tendon_angle)
    assert np.abs(sim.position - x)[:2].max() < 1e-6  # m in 10 s
    assert sim.ground_force[:, 0].sum() == pytest.approx(
        sim.parameters.weight * np.sin(np.radians(20.0)), rel=1e-3
    )


@pytest.mark.parametrize("friction", [0.4, 0.0])
def test_bristles_slide_above_the_friction_angle_by_coulombs_law(friction):
    sim = simulator(floor__friction=[friction] * 4, **inclined(25.0))
    before = robot_momentum(sim)[0]
    sim.advance(1000, sim.tendon_angle)
    gained = robot_momentum(sim)[0] - before
    weight, slope = sim.parameters.weight, np.radians(25.0)
    # N s, impulse of the floor in 1 s
    normal = weight * np.cos(slope) + gained[2]
    # the feet splay a little meanwhile
    assert gained[0] == pytest.approx(
        -weight * np.sin(slope) + friction * normal, rel=1e-4
    )


@pytest.mark.parametrize("nodes", [8, 121])
def test_the_total_contact_stiffness_is_the_same_at_any_number_of_nodes(nodes):
    """Sum of the points' stiffness = line stiffness times length + stiffness of the tip."""
    rod = discretise(ROBOT.leg, nodes, ROBOT.tendon.end_fraction)
    law, step = (
        build_floor(read_scene("flat").floor, rod, WIDTH),
        np.diff(rod.arc),
    )
    # without the half cells of clamp and tip
    length = rod.arc[-1] - (step[0] + step[-1]) / 2
    assert law.stiffness.sum() == pytest.approx(2e4 + 2.2e6 * length, rel=1e-12)


@pytest.mark.parametrize(
    ("speed", "rise"), [(0.036, -0.01), (1e-4, 0.0), (0.1, 2.0)]
)
def test_ground_force_is_the_sum_of_springs_dampers_and_friction_of_all_nodes(
    speed, rise
):
    """For a robot that moves rigidly over the floor, by hand; a floor that is left fast pulls not.

    At low speeds viscous friction stays below mu N.
    """
    sim = simulator(servo="pid")
    law, slip = floor(), speed * np.array([0.6, -0.8])
    sim.set_motion(np.array([*slip, rise]), np.zeros(3))
    depth = np.maximum(0.0, -sim.nodes[:, :, 2])
    depth[:, 0] = 0.0  # the clamp belongs to the torso
    stiffness, damping = at_nodes(law.stiffness), at_nodes(law.damping)
    normal = np.maximum(
        0.0, stiffness * depth - damping * rise * (depth > 0.0)
    ).sum(1)
    drag = 0.4 * normal / np.hypot(speed, law.friction_velocity)
    expected = np.column_stack([-np.outer(drag, slip), normal])
    assert (normal > 1.0).all() == (rise <= 0.0)
    np.testing.assert_allclose(sim.ground_force, expected, rtol=1e-9)


SPACING = 0.05
HEIGHT = np.random.default_rng(5).normal(0.0, 0.01, (7, 10))
Y, X = ((np.arange(n) - (n - 1) / 2) * SPACING for n in HEIGHT.shape)
EXACT = RegularGridInterpolator((Y, X), HEIGHT)


@njit
def ground_at(terrain, x, y):
    below = ground(terrain, x, y)
    return below.height, below.slope_x, below.slope_y


def test_heights_are_bilinear_as_scipys_also_beyond_the_edge_and_slopes_their_derivatives():
    """Beyond its edge the floor continues at the height of the edge."""
    step, end = 1e-6, np.array([X[-1], Y[-1]])
    rng, corners = (
        np.random.default_rng(7),
        [(-1.0, 0.013), (0.021, 1.0), (2.0, -3.0)],
    )
    # the central differences stay within a cell
    inner = rng.uniform(0.02, 0.98, (300, 2)) + rng.integers(
        0, [9, 6], (300, 2)
    )
    for x, y in [*(inner * SPACING - end), *corners]:
        height, *slopes = ground_at(Terrain(HEIGHT, SPACING), x, y)
        points = np.array([x, y]) + step * np.array(
            [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]
        )
        exact = EXACT(np.clip(points, -end, end)[:, ::-1])
        assert height == pytest.approx(exact[0], abs=1e-15)
        # Bilinear: differences along the axes are exact up to rounding, 1e-17 / 1e-6.
        derivatives = (exact[[1, 3]] - exact[[2, 4]]) / (2 * step)
        assert slopes == pytest.approx(derivatives, abs=1e-9)


SLOPE = np.radians(10.0)
# 2 m x 1.5 m, rising along x
PLANE = np.tan(SLOPE) * np.tile((np.arange(5) - 2.0) * 0.5, (4, 1))
TURN = Rotation.from_rotvec(
    [0.0, -SLOPE, 0.0]
).as_matrix()  # the plane's axes to odom


@pytest.mark.parametrize("law", ["viscous", "bristle"])
@pytest.mark.parametrize(
    ("friction", "pulled"), [(0.4, 1.1), (0.1, 1.1), (0.3, 0.0)]
)
def test_an_inclined_height_map_is_a_plane_under_tilted_gravity(
    own_config, law, friction, pulled
):
    """For 0.5 s after a fall from 20 mm: standing, sliding, or lying on the torso's corners."""
    np.savetxt(
        own_config / "scene/plane.csv", PLANE, delimiter=",", fmt="%.18e"
    )
    common = {
        "start__settle": 0.0,
        "start__height": 0.04,
        "floor__friction": [friction] * 4,
        "floor__torso_friction": friction,
        "floor__friction_law": law,
    }
    gravity = TURN.T @ [0.0, 0.0, -GRAVITY]
    flat = simulator(servo="pid", gravity=gravity.tolist(), **common)
    uneven = {"floor__height_map": "plane.csv", "floor__spacing": 0.5}
    tilted = simulator(servo="pid", **uneven, **common)
    tilted.state.position[:] = TURN @ flat.position
    tilted.state.rotation[:] = TURN
    for sim in (flat, tilted):
        sim.advance(500, np.full(4, pulled))
    # Rounding, amplified by contacts that open and close.
    np.testing.assert_allclose(tilted.position, TURN @ flat.position, atol=1e-8)
    np.testing.assert_allclose(tilted.rotation, TURN @ flat.rotation, atol=1e-7)
    np.testing.assert_allclose(tilted.nodes, flat.nodes @ TURN.T, atol=1e-7)
    np.testing.assert_allclose(
        tilted.ground_force, flat.ground_force @ TURN.T, atol=1e-3
    )
    if pulled == 0.0:
        corners = flat.position + flat.model.torso.corners @ flat.rotation.T
        assert corners[:, 2].min() < 1e-4  # the torso lies on the floor
