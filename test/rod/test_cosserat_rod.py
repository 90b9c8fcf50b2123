"""Cosserat rod against closed forms, boundary value problems and an independent integration."""

import math

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys
from scipy.integrate import solve_bvp, solve_ivp
from scipy.linalg import eig
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from slot_core.rod.cosserat_rod import CosseratRod, DivergenceError, RodState, Scheme
from slot_core.rod.model import (
    CLAMPED,
    FREE,
    PINNED,
    ROLLER,
    Circle,
    Geometry,
    Loads,
    Material,
    Rectangle,
    RodError,
    Support,
)
from slot_core.rod.statics import Branch, EquilibriumError, StaticSettings

THICKNESS = 1e-3
SLENDER = Material(12 / THICKNESS**3, 4 / THICKNESS**3, 1 / THICKNESS, 0.0)  # EI = rho A = 1
STRIP = Geometry(1.0, Rectangle(1.0, (THICKNESS, THICKNESS)))
LEG = Geometry(0.19, Rectangle(0.02, (0.0135, 0.0035)))
TPU = Material(1e7, 1e7 / 3, 1200.0, 5e-4)


def slender(elements=15, **options):
    """Rod with L = EI = rho A = 1, strain 1e-7 under a unit force, no shear, no rotary inertia."""
    return CosseratRod(SLENDER, STRIP, elements, shear=False, rotary_inertia=False, **options)


def bisshopp_drucker(p):
    """Tip (x, y) / L of the inextensible cantilever under P L^2/(EI) = p, by elliptic integrals."""

    def arc(a):
        m = (1 + math.sin(a)) / 2
        return ellipk(m) - ellipkinc(math.asin(math.sqrt(0.5 / m)), m) - math.sqrt(p)

    a = brentq(arc, 1e-12, math.pi / 2 - 1e-12, xtol=1e-14)
    m = (1 + math.sin(a)) / 2
    second = ellipe(m) - ellipeinc(math.asin(math.sqrt(0.5 / m)), m)
    return np.array([math.sqrt(2 * math.sin(a) / p), 1 - 2 * second / math.sqrt(p)])


def reissner(material, geometry, loads, shear=True):
    """Tip pose of a clamped rod by collocation of Reissner's equations.

    r' = R (strain + (1, 0)), angle' = M/EI + curvature, M' = -r' x n, n the load between s and L.
    """
    length, section = geometry.length, geometry.section
    samples = np.linspace(0.0, 1.0, 20001)
    middle = (samples[1:] + samples[:-1]) / 2
    mass = material.density * section.area(middle) * length / len(middle)
    beyond = np.concatenate([np.cumsum(mass[::-1])[::-1], [0.0]])
    dead, follower = np.array(loads.force), np.array(loads.follower)

    def slope(s, y, tip):
        f = s / length
        n = dead[:, None] + np.outer(loads.gravity, np.interp(f, samples, beyond))
        n += turned(follower, tip[0])[:, None]
        c, d = np.cos(y[2]), np.sin(y[2])
        axial = (c * n[0] + d * n[1]) / (material.young_modulus * section.area(f))
        across = (c * n[1] - d * n[0]) / (
            section.shear_factor * material.shear_modulus * section.area(f)
        )
        x, z = 1 + axial, across * shear
        dx, dy = c * x - d * z, d * x + c * z
        bend = y[3] / (material.young_modulus * section.second_moment(f)) + geometry.curvature
        return np.array([dx, dy, bend, dy * n[0] - dx * n[1]])

    def ends(a, b, tip):
        return np.array([a[0], a[1], a[2], b[3] - loads.moment, b[2] - tip[0]])

    s = np.linspace(0.0, length, 201)
    guess = np.array([s, 0 * s, 0 * s, 0 * s])
    solution = solve_bvp(slope, ends, s, guess, p=[0.0], tol=1e-9, max_nodes=20000)
    assert solution.success
    return solution.y[:3, -1]


def turned(vector, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def test_elliptic_integrals_used_here_give_the_published_values():
    np.testing.assert_allclose(bisshopp_drucker(1.0), [0.9435667637, 0.3017207738], atol=1e-9)
    np.testing.assert_allclose(bisshopp_drucker(10.0), [0.4450044022, 0.8106090249], atol=1e-9)


@pytest.mark.parametrize("p", [0.2, 1.0, 3.0, 10.0])
def test_cantilever_follows_the_elastica_to_fourth_order(p):
    exact, errors = bisshopp_drucker(p), []
    for elements in (4, 8, 15):
        rod = slender(elements)
        found = rod.solve_static(Loads(force=(0.0, p)))
        assert found.branch is Branch.PRIMARY
        errors.append(np.hypot(*(rod.state.pose[-1, :2] - exact)))
    assert errors[2] < 5e-6  # of the length, at 31 nodes; 2.1e-6 at p = 10
    # Up to p = 1 the last error is close to the stretch of the rod, p / (EA L^2) = 1e-7.
    if p > 1:
        assert np.log(errors[0] / errors[2]) / np.log(15 / 4) > 3.7


@pytest.mark.parametrize("elements", [2, 4, 15, 64])
def test_end_moment_closes_the_circle(elements):
    rod = slender(elements)
    rod.solve_static(Loads(moment=2 * math.pi))
    assert rod.state.pose[-1, 2] == pytest.approx(2 * math.pi, rel=1e-12)
    # The elements represent a circle exactly; the error left is Newton's tolerance.
    assert np.hypot(*rod.state.pose[-1, :2]) < 1e-9


@pytest.mark.parametrize("shear", [True, False])
@pytest.mark.parametrize(
    "loads",
    [
        Loads(force=(0.0, -1.0)),
        Loads(gravity=(30.0, -60.0)),  # along and across
        Loads(follower=(0.0, 2.0)),
        Loads(force=(0.5, 0.0), moment=0.05, follower=(-0.5, 0.3), gravity=(0.0, 9.81)),
    ],
)
def test_curved_tapered_leg_bends_as_in_reissners_equations(loads, shear):
    geometry = Geometry(LEG.length, LEG.section, curvature=3.0)
    exact, errors = reissner(TPU, geometry, loads, shear), []
    for elements in (15, 30):
        rod = CosseratRod(TPU, geometry, elements, shear=shear)
        rod.solve_static(loads)
        errors.append(rod.state.pose[-1] - exact)
    assert np.abs(errors[1]).max() < 2e-5  # m and rad; the tip turns by about 1 rad
    assert np.hypot(*errors[1][:2]) < 2e-6
    assert np.abs(errors[0]).max() / np.abs(errors[1]).max() > 10  # fourth order gives 16


def test_short_cantilever_deflects_as_timoshenkos_beam():
    material, side, force = Material(1e7, 4e6, 1e3, 0.0), 0.05, 1e-3
    section = Rectangle(side, (side, side))
    rod = CosseratRod(material, Geometry(0.2, section), 1)
    rod.solve_static(Loads(force=(0.0, force)))
    bending = force * 0.2**3 / (3 * 1e7 * side**4 / 12)
    shearing = force * 0.2 / (5 / 6 * 4e6 * side**2)
    # Squares of the slope, 1e-5^2, are negligible. One element is exact up to rounding, at a tip
    # that moves by 5e-6 of the length.
    assert rod.state.pose[-1, 1] == pytest.approx(bending + shearing, rel=1e-8)


@pytest.mark.parametrize(
    ("base", "tip", "load"),
    [(CLAMPED, FREE, math.pi**2 / 4), (PINNED, ROLLER, math.pi**2)],
)
def test_column_becomes_unstable_at_eulers_load(base, tip, load):
    rod = slender(base=base, tip=tip)
    found = rod.solve_static(Loads(force=(-1.2 * load, 0.0)))
    assert found.branch is Branch.UNSTABLE
    assert found.negative_pivots == 1
    # Rounding of the pivots, beside stretch and shear 1e7 times as stiff, exceeds the truncation.
    assert found.critical[0] * 1.2 == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("side", [1, -1])
def test_buckled_column_has_the_shape_of_the_elastica(side):
    load = 3.0
    rod = slender()
    found = rod.solve_static(Loads(force=(-load, 0.0)), StaticSettings(stay_stable=True, side=side))
    angle = brentq(lambda a: ellipk(math.sin(a / 2) ** 2) - math.sqrt(load), 0.1, 3.0)
    assert (found.branch, found.negative_pivots) == (Branch.SECONDARY, 0)
    assert rod.state.pose[-1, 2] == pytest.approx(side * angle, rel=1e-5)  # fourth order
    height = 2 * math.sin(angle / 2) / math.sqrt(load)
    assert rod.state.pose[-1, 1] == pytest.approx(side * height, rel=1e-5)


def test_snap_through_is_an_error_with_the_last_load_factor():
    thickness, curvature = 0.03, 0.28  # rise 35 mm: it snaps before any unsymmetric buckling
    material = Material(12 / thickness**3, 4 / thickness**3, 1 / thickness, 0.0)
    geometry = Geometry(1.0, Rectangle(1.0, (thickness, thickness)), -curvature)
    pose = (0.0, 0.0, curvature / 2)
    rod = CosseratRod(material, geometry, 8, base=PINNED, tip=PINNED, pose=pose, shear=False)
    free = rod.free_unknowns()
    first = np.linalg.eigvalsh(rod.tangent()[np.ix_(free, free)])[0]
    with pytest.raises(EquilibriumError, match="load factor 0") as caught:
        rod.solve_static(Loads(gravity=(0.0, -400.0)))
    last = np.linalg.eigvalsh(rod.tangent()[np.ix_(free, free)])[0]
    # A fold: the rod is left where its tangent is nearly singular, still above the chord.
    assert 0.0 < caught.value.load_factor < 1.0
    assert 0.0 <= last < 0.05 * first
    assert rod.state.pose[8, 1] > 0.0


BEAM = np.array([1.8751040687, 4.6940911330, 7.8547574382]) ** 2


def test_uniform_cantilever_has_bernoullis_frequencies():
    found = slender().natural_frequencies(3) * 2 * math.pi
    np.testing.assert_array_less(np.abs(found / BEAM - 1), [2e-6, 2e-5, 2e-4])  # fourth order


def test_tapered_cantilever_has_its_known_frequencies():
    geometry = Geometry(1.0, Rectangle(1.0, (THICKNESS, THICKNESS / 2)))
    rod = CosseratRod(SLENDER, geometry, 15, shear=False, rotary_inertia=False)
    exact = [3.8237848473, 18.3172609042, 47.2648270105]
    found = rod.natural_frequencies(3) * 2 * math.pi
    np.testing.assert_array_less(np.abs(found / exact - 1), [2e-6, 2e-5, 2e-4])


def test_leg_without_shear_has_its_known_frequencies():
    rod = CosseratRod(TPU, LEG, 15, shear=False, rotary_inertia=False)
    exact = [6.5209720302, 25.5124367433, 61.3511026964]  # Bernoulli's beam, Hz
    np.testing.assert_array_less(np.abs(rod.natural_frequencies(3) / exact - 1), [2e-6, 2e-5, 2e-4])


def test_free_rod_has_three_rigid_modes_and_bernoullis_frequencies():
    rod = slender(base=FREE, tip=FREE)
    found = rod.natural_frequencies(5) * 2 * math.pi
    # Error of the squared frequency: rounding of the axial stiffness, 1e-16 * 1e7 * 30^2.
    assert np.abs(found[:3]).max() < 0.1
    exact = np.array([4.7300407449, 7.8532046241]) ** 2
    np.testing.assert_allclose(found[3:], exact, rtol=2e-4)


def test_stocky_beam_has_timoshenkos_frequencies():
    """Simply supported, wave number k: (k^2 EI/s - rho I w^2 + s)(k^2 s - rho A w^2) = s^2 k^2."""
    material, length, side = Material(1e7, 4e6, 1e3, 0.0), 0.2, 0.03
    section = Rectangle(side, (side, side))
    rod = CosseratRod(material, Geometry(length, section), 15, base=PINNED, tip=ROLLER)
    exact = []
    for mode in (1, 2, 3):
        k = mode * math.pi / length
        bending, shear = 1e7 * side**4 / 12, 5 / 6 * 4e6 * side**2
        mass, inertia = 1e3 * side**2, 1e3 * side**4 / 12
        b = (bending * k * k + shear) * mass + shear * k * k * inertia
        c = bending * k * k * shear * k * k
        square = (b - math.sqrt(b * b - 4 * mass * inertia * c)) / (2 * mass * inertia)
        exact.append(math.sqrt(square) / (2 * math.pi))
    found = rod.natural_frequencies(6)
    nearest = [found[np.abs(found - f).argmin()] for f in exact]  # axial modes lie in between
    np.testing.assert_allclose(nearest, exact, rtol=2e-4)  # fourth order in 3 pi / 15


@pytest.mark.parametrize(("load", "flutters"), [(19.95, False), (20.15, True)])
def test_column_under_a_follower_force_flutters_beyond_becks_load(load, flutters):
    """Beck (1952): P L^2/(EI) = 20.05."""
    rod = slender()
    rod.solve_static(Loads(follower=(-load, 0.0)))
    free = rod.free_unknowns()
    stiffness = rod.tangent(Loads(follower=(-load, 0.0)))[np.ix_(free, free)]
    mass = np.diag(rod.mass.ravel()[free])
    flexibility = eig(mass, stiffness, right=False)  # 1 / omega^2; zero for massless angles
    lowest = flexibility[np.argsort(-np.abs(flexibility))[:2]]
    assert (np.abs(lowest.imag).max() > 1e-3 * np.abs(lowest).max()) == flutters


def flying(scheme):
    """Curved, tapered, undamped leg in free flight that translates, spins and vibrates."""
    geometry = Geometry(LEG.length, LEG.section, curvature=4.0)
    material = Material(1e7, 1e7 / 3, 1200.0, 0.0)
    rod = CosseratRod(material, geometry, 8, base=FREE, tip=FREE, scheme=scheme)
    pose = rod.state.pose
    velocity = 8.0 * np.column_stack([-pose[:, 1], pose[:, 0], np.ones(len(pose))])
    velocity[:, :2] += [0.3, -0.2]
    velocity[:, 1] += 60.0 * (pose[:, 0] - 0.1) ** 2  # bends the leg
    rod.state = RodState(pose, velocity)
    return rod


def test_free_flight_conserves_momentum_for_a_second_and_bounds_the_energy_error():
    rod = flying(Scheme(theta=0.5, tolerance=1e-13))
    before, energy = np.array(rod.momentum()), rod.energy().total
    drift = 0.0
    for _ in range(10):
        rod.run(5e-4, 200)
        drift = max(drift, abs(rod.energy().total / energy - 1))
    scale = np.abs(before)
    np.testing.assert_array_less(np.abs(rod.momentum() - before), 1e-10 * scale)
    # The midpoint rule does not conserve energy; the error oscillates by 1e-4 without drift.
    assert drift < 5e-4


def test_gravity_in_free_flight_changes_momentum_by_its_impulse():
    rod = flying(Scheme(theta=0.5, tolerance=1e-13))
    before, mass = np.array(rod.momentum()), rod.mass[:, 0].sum()
    rod.run(1e-3, 100, Loads(gravity=(1.0, -9.81)))
    impulse = np.array(rod.momentum())[:2] - before[:2]
    np.testing.assert_allclose(impulse, np.array([1.0, -9.81]) * mass * 0.1, rtol=1e-10)


class Independent:
    """Second implementation of E quadratic elements: polynomials and complex-step derivatives."""

    def __init__(self, material, geometry, elements, held):
        self.material, self.section = material, geometry.section
        self.size, self.nodes, self.held = geometry.length / elements, 2 * elements + 1, held
        f = np.linspace(0, 1, self.nodes)
        weight = np.full(self.nodes, 2.0)
        weight[1::2], weight[[0, -1]] = 4.0, 1.0
        weight *= self.size / 6 * material.density
        area, second = self.section.area(f), self.section.second_moment(f)
        self.mass = np.column_stack([weight * area, weight * area, weight * second]).ravel()
        self.stiffness = np.array([self.moduli(e, x) for e in range(elements) for x in (-1, 1)])
        self.rest = np.zeros(0)
        self.rest = self.strains(np.column_stack([f * geometry.length, 0 * f, 0 * f]).ravel())

    def moduli(self, e, side):
        f = np.array((e + 0.5 + side / math.sqrt(12)) * self.size / (self.size * (self.nodes // 2)))
        area, m = self.section.area(f), self.material
        lateral = 5 / 6 * m.shear_modulus * area
        bending = m.young_modulus * self.section.second_moment(f)
        return np.array([m.young_modulus * area, lateral, bending]) * self.size / 2

    def strains(self, q):
        q, out = q.reshape(-1, 3), []
        for e in range(self.nodes // 2):
            a, b, c = q[2 * e : 2 * e + 3]
            for side in (-1, 1):
                u = side / math.sqrt(3)  # parabola b + (c - a)/2 u + (a - 2b + c)/2 u^2
                rate = ((c - a) / 2 + (a - 2 * b + c) * u) * 2 / self.size
                angle = (b + (c - a) / 2 * u + (a - 2 * b + c) / 2 * u * u)[2]
                x, y = turned(rate[:2], -angle)
                out.append([x, y, rate[2]])
        out = np.array(out)
        return out - self.rest if self.rest.size else out

    def jacobian(self, q):
        steps = q + 1e-30j * np.eye(len(q))
        return np.array([self.strains(step).imag.ravel() / 1e-30 for step in steps]).T

    def acceleration(self, q, v, load):
        b = self.jacobian(q)
        stress = self.stiffness.ravel() * (
            self.strains(q).ravel() + self.material.damping_time * b @ v
        )
        a = (load - b.T @ stress) / self.mass
        a[self.held] = 0.0
        return a


def test_motion_converges_to_an_independent_integration_with_second_order():
    elements, end = 2, 0.03
    own = Independent(TPU, LEG, elements, held=slice(0, 3))
    load = np.zeros(3 * own.nodes)
    load[-2] = 0.5
    start = np.column_stack([np.linspace(0, LEG.length, own.nodes), np.zeros((own.nodes, 2))])
    size = start.size

    def slope(t, y):
        return np.concatenate([y[size:], own.acceleration(y[:size], y[size:], load)])

    begin = np.concatenate([start.ravel(), np.zeros(size)])
    exact = solve_ivp(slope, (0, end), begin, method="Radau", rtol=1e-7, atol=1e-9)
    tip = exact.y[size - 3 : size - 1, -1]
    errors = []
    for steps in (30, 60, 120):
        rod = CosseratRod(TPU, LEG, elements)
        rod.run(end / steps, steps, Loads(force=(0.0, 0.5)))
        errors.append(np.hypot(*(rod.state.pose[-1, :2] - tip)))
    assert errors[0] / errors[2] > 12  # pure second order gives 16
    assert errors[2] < 2e-5  # m, of a motion of some centimetres


def test_accelerated_clamp_is_equivalent_to_gravity():
    """Equivalence principle: seen from a base with acceleration a, gravity is -a."""
    a, h, steps = np.array([4.0, -7.0]), 1e-3, 60
    carried, hanging = CosseratRod(TPU, LEG, 5), CosseratRod(TPU, LEG, 5)
    for n in range(1, steps + 1):
        shift = a * (n * h) ** 2 / 2
        carried.step(h, base=(shift[0], shift[1], 0.0))
        hanging.step(h, Loads(gravity=(-a[0], -a[1])))
    seen = carried.state.pose[:, :2] - shift
    # The midpoint rule integrates the parabola exactly; Newton's tolerance is 1e-9.
    np.testing.assert_allclose(seen, hanging.state.pose[:, :2], atol=1e-8)
    assert np.ptp(seen[:, 1]) > 1e-3  # the rod bends


def test_pinned_rod_swings_as_a_pendulum():
    """A stiff uniform bar on a hinge: small swings at sqrt(3 g / (2 L))."""
    stiff = Material(1e12, 4e11, 1e3, 0.0)
    tilt = 1e-3
    rod = CosseratRod(
        stiff,
        Geometry(0.3, Circle((0.01, 0.01))),
        2,
        base=PINNED,
        pose=(0.0, 0.0, -math.pi / 2 + tilt),
    )
    period = 2 * math.pi / math.sqrt(1.5 * 9.81 / 0.3)
    steps = 400
    rod.run(period / steps, steps, Loads(gravity=(0.0, -9.81)))
    # Rotary inertia shifts the phase by (d/L)^2 3/32 = 1e-4, at a maximum of the cosine.
    assert rod.state.pose[-1, 2] + math.pi / 2 == pytest.approx(tilt, rel=1e-5)


def test_damped_rod_settles_at_its_static_equilibrium():
    loads = Loads(force=(0.0, -0.5), gravity=(0.0, -9.81))
    material = Material(1e7, 1e7 / 3, 1200.0, 2e-2)
    moved, solved = CosseratRod(material, LEG, 4), CosseratRod(material, LEG, 4)
    moved.run(2e-3, 1500, loads)
    solved.solve_static(loads)
    np.testing.assert_allclose(moved.state.pose, solved.state.pose, atol=1e-8)


def test_stepping_allocates_no_memory():
    rod = CosseratRod(TPU, LEG, 5)
    loads, record = Loads(force=(0.0, 0.1)), np.zeros((0, 3))
    _nrt_python.memsys_enable_stats()
    counts = []
    for steps in (1, 1, 300):
        before = rtsys.get_allocation_stats().alloc
        rod._run(1e-3, steps, loads, record)
        counts.append(rtsys.get_allocation_stats().alloc - before)
    assert counts[1] == counts[2]  # allocations per call, for its arguments, not per step


def test_run_equals_repeated_step():
    one, other = CosseratRod(TPU, LEG, 4), CosseratRod(TPU, LEG, 4)
    loads = Loads(force=(0.0, 0.3))
    record = one.run(1e-3, 20, loads, samples=4)
    for _ in range(20):
        other.step(1e-3, loads)
    np.testing.assert_array_equal(one.state.pose, other.state.pose)
    np.testing.assert_array_equal(record[-1], one.state.pose[-1])


def test_divergence_is_an_error_with_time_step_and_node():
    rod = CosseratRod(Material(1e9, 3e8, 1200.0, 0.0), LEG, 15, scheme=Scheme(iterations=1))
    velocity = np.zeros((31, 3))
    velocity[1:, 1] = 1e200
    rod.state = RodState(rod.state.pose, velocity)
    with pytest.raises(DivergenceError, match=r"after t = 0 s in step 1 of 50 .* node \d+"):
        rod.run(1e-2, 50)


@pytest.mark.parametrize("shear", [True, False])
@pytest.mark.parametrize("elements", [8, 20])
def test_one_newton_iteration_per_step_follows_the_converged_damped_motion(elements, shear):
    """Released from 1 N, steps of 1 ms; shear that is off is a stiff, damped shear stiffness."""
    paths = []
    for iterations in (1, 20):
        scheme = Scheme(iterations=iterations)
        rod = CosseratRod(TPU, LEG, elements, shear=shear, rotary_inertia=shear, scheme=scheme)
        rod.solve_static(Loads(force=(0.0, -1.0)))
        start = rod.state.pose[-1, 1]
        paths.append(rod.run(1e-3, 1000, samples=100)[:, :2])
    # Measured: 1.2e-4 of the deflection; the error of the time step is 2e-3.
    assert np.abs(paths[0] - paths[1]).max() < 5e-4 * abs(start)


def test_divergence_with_finite_numbers_is_an_error():
    """One iteration is too few for this step without damping: the tip would move by rod lengths."""
    undamped = Material(1e7, 1e7 / 3, 1200.0, 0.0)
    rod = CosseratRod(undamped, LEG, 6, shear=False, scheme=Scheme(iterations=1))
    rod.solve_static(Loads(force=(0.0, -1.0)))
    with pytest.raises(DivergenceError):
        rod.run(4e-3, 250)


@pytest.mark.parametrize(("iterations", "unconverged"), [(1, 50), (20, 0)])
def test_unconverged_steps_are_counted(iterations, unconverged):
    rod = CosseratRod(TPU, LEG, 4, scheme=Scheme(iterations=iterations))
    rod.run(1e-3, 50, Loads(force=(0.0, 0.5)))
    assert rod.unconverged == unconverged


@pytest.mark.parametrize(
    ("act", "rule"),
    [
        (lambda: Material(-1.0, 1.0, 1.0, 0.0), "young_modulus -1.0 must be above 0"),
        (lambda: Material(math.nan, 1.0, 1.0, 0.0), "young_modulus nan"),
        (lambda: Rectangle(0.02, (0.01, -0.01)), "thickness"),
        (lambda: Geometry(0.0, LEG.section), "length 0.0 must be above 0"),
        (lambda: slender(0), "elements 0 must be at least 1"),
        (lambda: Scheme(theta=0.4), "theta 0.4 must be within"),
        (lambda: slender().step(math.nan), "step nan"),
        (lambda: slender().step(1e-3, base=(math.nan, 0.0, 0.0)), "must be finite"),
        (lambda: slender().step(1e-3, Loads(moment=math.inf)), "must be finite"),
        (lambda: slender().natural_frequencies(1, Loads(follower=(1.0, 0.0))), "follower"),
        (lambda: StaticSettings(side=0), "side 0"),
        (
            lambda: slender().solve_static(
                Loads(follower=(1.0, 0.0)), StaticSettings(stay_stable=True)
            ),
            "stay_stable needs",
        ),
    ],
)
def test_invalid_arguments_are_refused_by_name(act, rule):
    with pytest.raises(RodError, match=rule):
        act()


def test_guided_tip_deflects_by_a_twelfth_of_the_unit_load():
    """Clamped at the base, guided at the tip: deflection P L^3 / (12 EI)."""
    rod = slender(tip=Support(x=False, y=False, angle=True))
    force = 1e-5
    rod.solve_static(Loads(force=(0.0, force)))
    assert rod.state.pose[-1, 1] == pytest.approx(force / 12, rel=2e-6)  # shear off: 12e-7
