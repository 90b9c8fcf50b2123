"""Motion of the Cosserat rod: conservation, supports and hard cases.

Natural frequencies of the Cosserat rod against closed forms and Ritz's method.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
from leg_energy import directions
from scipy.linalg import eigh

from benchmarks.rod.release import LEG, TPU
from slot_core.arrays import Array
from slot_core.refusal import DivergenceError
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import (
    FREE,
    Circle,
    Geometry,
    Loads,
    Material,
    Plane,
    Pose,
    Rectangle,
    RodState,
    RodTendon,
    Scheme,
    Support,
    Uniform,
)

# EI = rho A = 1 at a thickness of 1e-3
THIN_MATERIAL = Material(12e9, 4e9, 1e3, 0.0)
# of sections that are given by their stiffness
UNIT = Material(1.0, 1.0, 1e-6, 0.0)
Field = Callable[[Array], Array]
FREQUENCIES = {  # rad/s with EI = rho A = L = 1; the leg's in Hz
    "uniform": np.array([1.8751040687, 4.6940911330, 7.8547574382]) ** 2,
    "tapered": np.array([3.8237848473, 18.3172609042, 47.2648270105]),
    "leg": np.array([6.5209720302, 25.5124367433, 61.3511026964]),
}


def sideways(material: Material, geometry: Geometry, count: int) -> Array:
    """Lowest frequencies (count,), Hz, of a straight cantilever that bends sideways (`_ritz`)."""
    constants = geometry.section.constants
    speed = math.sqrt(material.young_modulus / material.density)
    found = speed * _ritz(
        lambda f: constants(f)[2], lambda f: constants(f)[0], 2
    )
    return found[:count] / (2 * math.pi * geometry.length**2)


def twisting(material: Material, geometry: Geometry, count: int) -> Array:
    """Lowest frequencies (count,), Hz, of a straight cantilever that twists (`_ritz`)."""
    constants = geometry.section.constants
    speed = math.sqrt(material.shear_modulus / material.density)
    found = speed * _ritz(
        lambda f: constants(f)[3], lambda f: sum(constants(f)[1:3]), 1
    )
    return found[:count] / (2 * math.pi * geometry.length)


def _ritz(stiffness: Field, mass: Field, order: int) -> Array:
    """Frequencies w of -+(k u^(n))^(n) = w^2 m u on 0 .. 1, held at 0: Ritz's method.

    n = order; the trial functions x^n P_j(2 x - 1) with Legendre's polynomials meet u = 0 and, for
    n = 2, u' = 0 at the clamp.
    """
    x, weight = np.polynomial.legendre.leggauss(60)
    x, weight = (x + 1) / 2, weight / 2
    power = np.polynomial.Polynomial([0.0] * order + [1.0])
    shapes = [
        power
        * np.polynomial.Legendre.basis(j, domain=[0, 1]).convert(
            kind=np.polynomial.Polynomial
        )
        for j in range(16)
    ]
    bent = np.array([shape.deriv(order)(x) for shape in shapes])
    moved = np.array([shape(x) for shape in shapes])
    return np.sqrt(
        eigh(
            (bent * weight * stiffness(x)) @ bent.T,
            (moved * weight * mass(x)) @ moved.T,
            eigvals_only=True,
        )
    )


def flying():
    """Curved, tapered, undamped leg in free flight that tumbles, bends and twists."""
    undamped = Material(TPU.young_modulus, TPU.shear_modulus, TPU.density, 0.0)
    geometry = Geometry(LEG.length, LEG.section, curvature=4.0)
    scheme = Scheme(theta=0.5, tolerance=1e-14)
    rod = CosseratRod(undamped, geometry, 17, base=FREE, scheme=scheme)
    state, rate = rod.state, np.array([6.0, 8.0, -4.0])
    r = state.position
    velocity = np.cross(rate, r) + np.array([0.3, -0.2, 0.1])
    # bends the leg
    velocity[:, 1:] += np.outer((r[:, 0] - 0.1) ** 2, [40.0, 60.0])
    t = directions(r)
    spin = t @ rate + np.linspace(-20.0, 30.0, 16)  # twists it
    rod.state = RodState(
        r, state.director, velocity, spin[:, None] * t, state.ends
    )
    return rod


def test_tumbling_twisting_flight_conserves_momentum_and_bounds_the_energy():
    """For a second; then gravity changes the momentum by its impulse."""
    rod = flying()
    linear, angular = rod.momentum()
    energy, drift = rod.energy().total, 0.0
    for _ in range(10):
        rod.run(5e-4, 200)
        drift = max(drift, abs(rod.energy().total / energy - 1))
    now, turned = rod.momentum()
    assert np.abs(now - linear).max() < 1e-12 * np.linalg.norm(linear)
    assert np.abs(turned - angular).max() < 1e-12 * np.linalg.norm(angular)
    # The midpoint rule does not conserve energy; the error oscillates by 6e-5 without drift.
    assert drift < 2e-4
    gravity = np.array([1.0, 2.0, -9.81])
    rod.run(1e-3, 100, Loads(gravity=tuple(gravity)))
    impulse = rod.momentum()[0] - now
    np.testing.assert_allclose(impulse, gravity * rod.mass * 0.1, rtol=1e-9)


def test_accelerated_clamp_is_equivalent_to_gravity():
    """Equivalence principle: seen from a base with acceleration a, gravity is -a."""
    a, h, steps = np.array([4.0, 3.0, -7.0]), 1e-3, 60
    carried, hanging = CosseratRod(TPU, LEG, 9), CosseratRod(TPU, LEG, 9)
    for n in range(1, steps + 1):
        shift = a * (n * h) ** 2 / 2
        carried.step(h, base=Pose(tuple(shift)))
        hanging.step(h, Loads(gravity=tuple(-a)))
    seen = carried.state.position - shift
    # The midpoint rule integrates the parabola exactly, but for the clamp's start from rest.
    np.testing.assert_allclose(seen, hanging.state.position, atol=3e-7)
    assert np.ptp(seen[:, 1]) > 1e-4  # the rod bends in both planes
    assert np.ptp(seen[:, 2]) > 1e-3


def test_pinned_rod_swings_as_a_pendulum():
    """A stiff uniform bar on a hinge: small swings at sqrt(3 g / (2 L))."""
    tilt = 1e-3
    pose = Pose(rotation=(0.0, math.pi / 2 - tilt, 0.0))
    rod = CosseratRod(
        Material(1e12, 4e11, 1e3, 0.0),
        Geometry(0.3, Circle((0.01, 0.01))),
        5,
        base=Support((True, True, True), (True, False, True)),
        pose=pose,
    )
    period = 2 * math.pi / math.sqrt(1.5 * 9.81 / 0.3)
    rod.run(period / 400, 400, Loads(gravity=(0.0, 0.0, -9.81)))
    assert rod.state.position[-1, 0] / 0.3 == pytest.approx(tilt, rel=1e-4)


def test_damped_rod_on_a_turned_clamp_settles_at_its_static_equilibrium():
    """Its clamp turns by a quarter about an oblique axis while forces act."""
    loads = Loads(force=(0.0, 0.3, -0.5), gravity=(0.0, 0.0, -9.81))
    material = Material(1e7, 1e7 / 3, 1200.0, 2e-2)
    geometry = Geometry(LEG.length, LEG.section, 3.0)
    turn = np.array([2.0, -1.0, 2.0]) / 3 * math.pi / 2
    moved = CosseratRod(material, geometry, 9)
    for part in np.linspace(0.0, 1.0, 401)[1:]:
        moved.step(2e-3, loads, base=Pose(rotation=tuple(part * turn)))
    moved.run(2e-3, 1500, loads)
    solved = CosseratRod(material, geometry, 9, pose=Pose(rotation=tuple(turn)))
    solved.solve_static(loads)
    np.testing.assert_allclose(
        moved.state.position, solved.state.position, atol=1e-8
    )
    np.testing.assert_allclose(
        moved.state.director, solved.state.director, atol=1e-7
    )
    np.testing.assert_allclose(moved.state.ends, solved.state.ends, atol=1e-7)


def test_a_damped_rod_with_tendons_settles_against_a_wall_at_its_equilibrium():
    """One tendon of a given length, one that becomes slack, and its weight across."""
    tendons = [
        RodTendon((0.0, 6e-3), stiffness=2e4),
        RodTendon((3e-3, -6e-3), stiffness=2e4),
    ]
    wall = Plane((0.0, 0.0, 0.03), (0.0, 0.2, -1.0), 2e4, 5e-3, damping=50.0)
    material = Material(1e6, 3.3e5, 1100.0, 2e-2)
    moved, solved = (
        CosseratRod(
            material,
            LEG,
            13,
            scheme=Scheme(1.0),
            tendons=tendons,
            planes=[wall],
        )
        for _ in range(2)
    )
    for drawn in np.linspace(0.0, 0.01, 101)[1:]:
        loads = Loads(gravity=(0.0, 2.0, 0.0), length=(0.19 - drawn, 0.2))
        moved.step(5e-3, loads)
    moved.run(5e-3, 500, loads)
    solved.solve_static(loads)
    (pull, length), (slack, _) = solved.tendons
    assert pull > 0.5
    assert pull == pytest.approx(2e4 * (length - 0.18), rel=1e-6)
    assert slack == 0.0
    assert solved.tip.position[2] > 0.025
    np.testing.assert_allclose(
        moved.state.position, solved.state.position, atol=1e-7
    )


def test_a_rod_that_slides_on_a_floor_is_braked_by_coulombs_law():
    floor = Plane((0.0,) * 3, (0.0, 0.0, 1.0), 1e4, friction=0.3)
    geometry = Geometry(0.2, Circle((0.01, 0.01)))
    weight = TPU.density * math.pi / 4 * 1e-4 * 9.81  # N/m
    start = Pose((0.0, 0.0, -weight / 1e4))
    rod = CosseratRod(TPU, geometry, 9, FREE, pose=start, planes=[floor])
    state, h = rod.state, 1e-3
    velocity = np.tile([0.3, 0.4, 0.0], (9, 1))
    rod.state = RodState(
        state.position, state.director, velocity, state.swirl, state.ends
    )
    rod.run(h, 100, Loads(gravity=(0.0, 0.0, -9.81)))
    slower = (0.5 - 0.3 * 9.81 * 100 * h) * np.array([0.6, 0.8, 0.0])
    moved = np.broadcast_to(slower, (9, 3))
    np.testing.assert_allclose(rod.state.velocity, moved, atol=1e-4)


@pytest.mark.parametrize("turns", [0.55, 1.2])
def test_rod_twisted_beyond_a_turn_stays_sound_when_kicked_sideways(turns):
    """The tip is turned by more than 180 and 360 deg about the axis, then the middle is kicked."""
    slide = Support((False, True, True), (True, True, True))
    material = Material(1e7, 1e7 / 3, 1200.0, 2e-3)
    rod = CosseratRod(
        material, Geometry(0.3, Circle((0.02, 0.02))), 21, tip=slide
    )
    steps = 300
    for n in range(1, steps + 1):
        angle = 2 * math.pi * turns * n / steps
        rod.step(1e-3, tip=Pose((0.3, 0.0, 0.0), (angle, 0.0, 0.0)))
    state = rod.state
    velocity = state.velocity.copy()
    velocity[7:14, 1] += 2.0
    rod.state = RodState(
        state.position, state.director, velocity, state.swirl, state.ends
    )
    rod.run(1e-3, 50)
    assert np.abs(rod.state.position[:, 1]).max() > 1e-4
    rod.run(1e-3, 2000)
    even = (
        np.cumsum(np.full(20, 2 * math.pi * turns / 20)) - math.pi * turns / 20
    )
    director = rod.state.director
    expected = np.column_stack([np.zeros(20), -np.cos(even), -np.sin(even)])
    # Evenly but for the hinges' weights at the ends, 3/8, 7/6 and 23/24 of a step.
    assert np.abs(director - expected).max() < 0.3 * 2 * math.pi * turns / 20
    assert np.abs(rod.state.position[:, 1:]).max() < 1e-6


def test_run_equals_repeated_step():
    one, other = CosseratRod(TPU, LEG, 9), CosseratRod(TPU, LEG, 9)
    loads = Loads(force=(0.0, 0.2, 0.3))
    record = one.run(1e-3, 20, loads, samples=4)
    for _ in range(20):
        other.step(1e-3, loads)
    np.testing.assert_array_equal(one.state.position, other.state.position)
    np.testing.assert_array_equal(record[-1], one.state.position[-1])


def test_divergence_is_an_error_with_time_step_and_node():
    rod = CosseratRod(
        Material(1e9, 3e8, 1200.0, 0.0), LEG, 31, scheme=Scheme(iterations=1)
    )
    state = rod.state
    velocity = np.zeros((31, 3))
    velocity[1:, 1] = 1e200
    rod.state = RodState(
        state.position, state.director, velocity, state.swirl, state.ends
    )
    with pytest.raises(
        DivergenceError, match=r"after t = 0 s in step 1 of 50 .* node \d+"
    ):
        rod.run(1e-2, 50)


@pytest.mark.parametrize("nodes", [7, 17, 22])
def test_one_newton_iteration_per_step_follows_the_converged_damped_motion(
    nodes,
):
    """Released from an oblique force of 1 N, steps of 1 ms."""
    paths = []
    for iterations in (1, 20):
        rod = CosseratRod(TPU, LEG, nodes, scheme=Scheme(iterations=iterations))
        rod.solve_static(Loads(force=(0.0, 0.6, -0.8)))
        start = np.linalg.norm(rod.state.position[-1, 1:])
        paths.append(rod.run(1e-3, 1000, samples=100))
        assert (rod.unconverged > 0) == (iterations == 1)
    # below the error of the time step
    assert np.abs(paths[0] - paths[1]).max() < 2e-3 * start


BENDING = [1e-6, 2e-5, 2e-4]  # fourth order
UNIFORM, TAPERED = (
    FREQUENCIES[name] / (2 * math.pi) for name in ("uniform", "tapered")
)
SPIN = 1e-6 * 3.0  # density times polar moment
QUARTER_WAVES = (np.arange(3) + 0.5) * math.sqrt(0.8 / SPIN) / 2


def uniform(torsion, **options):
    geometry = Geometry(1.0, Uniform(1e6, 1.0, 2.0, torsion))
    return CosseratRod(UNIT, geometry, **options)


# Rod, its lowest frequencies (Hz), how many to find, relative errors. Spins are lumped: twisting is
# of second order. The leg sideways and in twist: Ritz's method.
RODS = {
    "uniform": (uniform(1e4), UNIFORM, 16, BENDING),
    "uniform, sideways": (uniform(1e4), math.sqrt(2.0) * UNIFORM, 16, BENDING),
    "uniform, twist": (uniform(0.8), QUARTER_WAVES, 90, [2e-4, 2e-3, 5e-3]),
    "tapered": (
        CosseratRod(THIN_MATERIAL, Geometry(1.0, Rectangle(1.0, (1e-3, 5e-4)))),
        TAPERED,
        16,
        BENDING,
    ),
    "leg": (
        CosseratRod(TPU, LEG),
        FREQUENCIES["leg"],
        16,
        [2e-6, 3e-5, 2e-4],
    ),
    "leg, sideways": (
        CosseratRod(TPU, LEG),
        sideways(TPU, LEG, 3),
        16,
        [2e-6, 3e-5, 2e-4],
    ),
    "leg, twist": (
        CosseratRod(TPU, LEG, 61),
        twisting(TPU, LEG, 2),
        40,
        [2e-4, 6e-4],
    ),
}


@pytest.mark.parametrize("name", RODS)
def test_cantilever_has_the_frequencies_of_closed_forms_and_of_ritzs_method(
    name,
):
    rod, wanted, count, errors = RODS[name]
    found = rod.natural_frequencies(count)
    nearest = [np.abs(found / frequency - 1).min() for frequency in wanted]
    np.testing.assert_array_less(nearest, errors)


def test_free_rod_has_six_rigid_modes_and_bernoullis_frequencies():
    found = uniform(0.8, base=FREE).natural_frequencies(10) * 2 * math.pi
    # Error of the squared frequency: rounding of the axial stiffness, 1e-16 * 1e6 * 30^2.
    assert np.abs(found[:6]).max() < 0.1
    plane = np.array([4.7300407449, 7.8532046241]) ** 2
    exact_frequencies = np.sort([*plane, *(math.sqrt(2) * plane)])
    np.testing.assert_allclose(found[6:], exact_frequencies, rtol=1e-4)
