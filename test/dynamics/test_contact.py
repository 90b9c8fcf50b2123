"""Contact with the floor compared with Coulomb's law.

Height maps compared with SciPy's interpolation and with an inclined plane.

Lanes compared with NumPy, and four legs in lanes with the same equations leg by leg.
"""

import copy
import math
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.core.errors import NumbaError, TypingError
from rod_robots import ROBOT, advance_one_by_one, simulator
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from slot_core import compiled, config
from slot_core.dynamics import integrator
from slot_core.dynamics.algebra import add, cosine_sine, scaled
from slot_core.dynamics.contact import (
    RELEASING,
    Terrain,
    advance_bristle,
    coefficient,
    friction_force,
    ground,
)
from slot_core.dynamics.handle import Handle
from slot_core.dynamics.lanes import (
    all_lanes,
    any_lane,
    in_lanes,
    largest,
    like,
    total,
    where,
)
from slot_core.dynamics.model import build_floor
from slot_core.dynamics.rod import discretise
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.spatial.strain import rotation_vector
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


def momentum(sim):
    """(3,) kg m/s."""
    legs = np.einsum("n,lni->i", sim.model.rod.mass, sim._observe()[1])
    return sim.model.torso.mass * sim.velocity + legs


@pytest.mark.parametrize("friction", [0.4, 0.0])
def test_bristles_slide_above_the_friction_angle_by_coulombs_law(friction):
    sim = simulator(floor__friction=[friction] * 4, **inclined(25.0))
    before = momentum(sim)
    sim.advance(1000, sim.tendon_angle)
    gained = momentum(sim) - before
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


FEATURES = {
    "bristles": {"floor__friction_law": "bristle"},
    "direction": {
        "floor__friction_varies": "direction",
        "floor__friction_other": [0.1] * 4,
    },
    "phase": {
        "floor__friction_varies": "phase",
        "floor__friction_other": [0.1] * 4,
    },
    "map": {"floor__height_map": "uneven.csv"},
    "map with bristles": {
        "floor__height_map": "uneven.csv",
        "floor__friction_law": "bristle",
    },
    "tips": {"floor__contact": "tip"},
    "payload": {"payload__mass": 0.5, "payload__place": [0.02, 0.03, 0.04]},
    "faults": {
        "tendons__slack": [0.0, 2e-3, 0.0, 0.0],
        "tendons__broken": [False, False, True, False],
    },
    "pid": {"servo": {"model": "pid", "integral": 5.0, "backlash_deg": 2.0}},
}


def run(sims, degrees, steps):
    """Advance robots, the legs of the second one by one, of the others in lanes."""
    for number, sim in enumerate(sims):
        sim._legs.command[0] = np.radians(degrees)
        if number == 1:
            assert advance_one_by_one(sim, steps) == (steps, -1)
        else:
            assert integrator.advance(sim.handle, steps) == (steps, -1)


@pytest.mark.parametrize("feature", FEATURES)
def test_legs_in_lanes_move_as_legs_one_by_one_with_every_feature(feature):
    """From the start for 0.3 s, tendons pulled and then partly released, each leg differently."""
    rest = {"start__settle": 0.0}
    changed = rest | FEATURES[feature]
    lanes, single, plain = sims = [
        simulator(**c) for c in (changed, changed, rest)
    ]
    for degrees in [[90.0, 40.0, 60.0, 75.0]] * 6 + [
        [30.0, 70.0, 0.0, 75.0]
    ] * 4:
        run(sims, degrees, 30)
        a, b = lanes.state, single.state
        np.testing.assert_allclose(a.buffer, b.buffer, rtol=1e-6, atol=1e-5)
        np.testing.assert_allclose(a.node, b.node, rtol=0, atol=1e-7)
    # m: the feature has an effect
    assert np.abs(lanes.state.node - plain.state.node).max() > 1e-5


def test_legs_in_lanes_halve_the_same_steps_as_legs_one_by_one():
    """An impact at 3 m/s with different tendon angles: contact and large angles in some lanes."""
    start = {"start__height": 0.06, "start__settle": 0.0}
    sims = [simulator(**start, solver__correction_limit=1e-4) for _ in range(2)]
    for sim in sims:
        sim.set_motion(np.array([0.0, 0.0, -3.0]), np.zeros(3))
    run(sims, np.degrees([1.9, 0.0, 1.0, 2.0]), 150)
    nodes, counters = zip(
        *((sim.state.node, sim._work.counter) for sim in sims)
    )
    np.testing.assert_allclose(*nodes, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(*counters)
    assert counters[0][0] > 0


class Pair(NamedTuple):
    """Operands and results of a kernel on lanes, (n, 4)."""

    a: np.ndarray
    out: np.ndarray


def on_lanes(function, count, *rows):
    """(count, 4) results that a function of two Lanes arrays (operands, results) writes."""
    pair = Pair(np.array(rows, dtype=float), np.full((count, 4), 7.0))
    inner = njit(function)

    @njit
    def run(pair):
        view = in_lanes(pair)
        inner(view.a, view.out)

    run(pair)
    return pair.out


A, B = np.array([1.5, -2.0, 0.0, 1e200]), np.array([0.5, 3.0, 2.0, 1e-9])


def test_lanes_compute_as_numpy_does():
    def kernel(v, out):
        a, b = v[0], v[1]
        out[0], out[1], out[2], out[3] = a + b, a - b, a * b, a / b
        out[4], out[5], out[6], out[7] = max(a, b), min(a, b), -a, math.sqrt(b)
        out[8], out[9], out[10], out[11] = (
            2.0 - a,
            3 * b,
            where(a > b, a, b),
            like(4.0, a),
        )
        out[12], out[13] = total(v[2]), largest(v[2])
        out[14] = (
            1.0 if any_lane(v[2] > 3.5) and not any_lane(v[2] < 1.0) else 0.0
        )
        out[15] = (
            1.0 if all_lanes(v[2] >= 1.0) and not all_lanes(v[2] > 3.5) else 0.0
        )
        one, none = like(1.0, a), like(0.0, a)
        out[16], out[17] = (
            where(v[3] < 1.0, one, none),
            where(v[3] >= 1.0, one, none),
        )
        a -= b
        a /= 2.0
        out[18] = a

    expected = [
        A + B,
        A - B,
        A * B,
        A / B,
        np.maximum(A, B),
        np.minimum(A, B),
        -A,
        np.sqrt(B),
    ]
    expected += [
        2 - A,
        3 * B,
        np.maximum(A, B),
        *(np.full(4, x) for x in (4, 10, 4)),
    ]
    # a comparison with NaN is false in its lane
    expected += [
        np.ones(4),
        np.ones(4),
        [0, 1, 0, 0],
        [0, 0, 1, 1],
        (A - B) / 2,
    ]
    special = [4.0, 1.0, 3.0, 2.0], [np.nan, 0.0, 1.0, np.inf]
    np.testing.assert_array_equal(
        on_lanes(kernel, 19, A, B, *special), expected
    )


def test_small_and_large_angles_are_exact_in_the_same_lanes():
    """Series and library function side by side; both are exact to rounding."""

    def kernel(v, out):
        out[0], out[1] = c, s = cosine_sine(v[0])
        one, none = like(1.0, v[0]), like(0.0, v[0])
        fixed = ((one, none, none), (none, one, none), (none, none, one))
        psi, _ = rotation_vector(
            fixed, ((c, none, -s), (none, one, none), (s, none, c))
        )
        out[2], out[3], out[4] = psi

    angles = np.array([0.0, 1e-3, 0.4, -3.0])
    expected = [np.cos(angles), np.sin(angles), 0 * angles, angles, 0 * angles]
    # near 180 deg the cosine's rounding grows by the tangent of half the angle
    np.testing.assert_allclose(
        on_lanes(kernel, 5, angles), expected, rtol=1e-15, atol=1e-16
    )


@pytest.mark.parametrize(
    ("act", "error", "message"),
    [
        (
            lambda: njit(lambda pair: in_lanes(pair).a[0])(
                Pair(np.zeros((4, 3)).T, np.zeros((3, 4)))
            ),
            TypingError,
            "last axis of an array",
        ),
        (
            lambda: copy.deepcopy(Handle((1.0, np.zeros(3)))),
            TypeError,
            "cannot be copied",
        ),
        (
            lambda: compiled.kernel(lambda n: np.zeros(n).size)(3),
            NumbaError,
            "NRT required|array passed into the function",
        ),
    ],
)
def test_strided_lanes_copied_handles_and_allocating_kernels_are_refused(
    act, error, message
):
    with pytest.raises(error, match=message):
        act()
