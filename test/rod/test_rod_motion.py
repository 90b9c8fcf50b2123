"""Motion of the Cosserat rod: conservation, an independent integration, supports and hard cases."""

import math

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys
from rods import flying
from scipy.integrate import solve_ivp

from benchmarks.rod.exact import LEG, TPU
from slot_core.refusal import DivergenceError
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import Circle, Geometry, Loads, Material, Pose, Support
from slot_core.rod.motion import RodState, Scheme

CONVERGED = Scheme(theta=0.5, tolerance=1e-14)


def test_tumbling_twisting_flight_conserves_momentum_for_a_second_and_bounds_the_energy():
    rod = flying(CONVERGED)
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


def test_gravity_in_free_flight_changes_momentum_by_its_impulse():
    rod = flying(CONVERGED)
    before, gravity = rod.momentum()[0], np.array([1.0, 2.0, -9.81])
    rod.run(1e-3, 100, Loads(gravity=tuple(gravity)))
    impulse = rod.momentum()[0] - before
    np.testing.assert_allclose(impulse, gravity * rod.mass * 0.1, rtol=1e-10)


class Independent:
    """Second implementation of the chain: energy and damping by complex-step derivatives.

    A coordinate is a displacement of a node (3 each) or the turn of a segment about itself (4 th).
    """

    def __init__(self, material, geometry, nodes):
        self.n, length, section = nodes, geometry.length, geometry.section
        h, f = length / (nodes - 1), np.linspace(0, 1, nodes)
        young, shear, rho = (
            material.young_modulus,
            material.shear_modulus,
            material.density,
        )
        w = {
            5: np.array([3 / 8, 7 / 6, 11 / 12, 7 / 6]),
            4: np.array([3 / 8, 9 / 8, 9 / 8]),
        }[nodes]
        m, w = (f[1:] + f[:-1]) / 2, w * h
        inner, outer = (
            young * section.second_moment(f),
            young * section.lateral_moment(f),
        )
        twist = shear * section.torsion_constant(f)
        hinge = np.column_stack([twist[:-1] / w, inner[:-1] / w, outer[:-1] / w])
        self.stiffness = np.concatenate([young * section.area(m) / h, hinge.ravel()])
        self.h, self.q, self.beta = h, h**3 / (24 * w**2), material.damping_time
        area = rho * section.area(f)
        mass = np.zeros((nodes, nodes))
        for k in range(nodes - 1):  # linear course of the mass, coupling of its middle
            a, b, mu = area[k] * h, area[k + 1] * h, rho * section.area(m[k]) * h / 6
            mass[k : k + 2, k : k + 2] += np.diag([(2 * a + b) / 6, (a + 2 * b) / 6])
            mass[k : k + 2, k : k + 2] -= mu * np.array([[1, -1], [-1, 1]])
        self.mass = mass[1:, 1:]  # node 0 is held
        polar = section.second_moment(m) + section.lateral_moment(m)
        self.spin = rho * polar * h

    def strains(self, r, d):
        """Extensions and rotation vectors of nodes r (n, 3) and directors d (n - 1, 3)."""
        u = np.diff(r, axis=0)
        length = np.sqrt((u * u).sum(axis=1))
        t = u / length[:, None]
        frames = [np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1]], dtype=complex)]
        frames += [np.array([t[k], d[k], np.cross(t[k], d[k])]) for k in range(len(t))]
        psi = np.array([self.log(frames[k] @ frames[k + 1].T) for k in range(len(t))])
        bulge = self.q * (psi[:, 1] ** 2 + psi[:, 2] ** 2)
        return np.concatenate([length - self.h - bulge, psi.ravel()])

    @staticmethod
    def log(m):
        """Rotation vector of a matrix, by its angle; analytic for angles below 180 deg."""
        axial = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]) / 2
        square = (axial * axial).sum()
        if abs(square) < 1e-12:
            return axial * (1 + square / 6)
        sine = np.sqrt(square)
        angle = (
            np.log(np.trace(m) / 2 - 0.5 + 1j * sine) / 1j
        )  # complex-step: not arctan2
        return axial * angle / sine

    def moved(self, r, d, x):
        """Nodes and directors after a small displacement x, to first order."""
        u = np.diff(r, axis=0)
        t = u / np.linalg.norm(u, axis=1)[:, None]
        shift = np.vstack([np.zeros(3), x[: 3 * (self.n - 1)].reshape(-1, 3)])
        w = np.cross(t, np.diff(shift, axis=0)) / np.linalg.norm(u, axis=1)[:, None]
        w = w + x[3 * (self.n - 1) :, None] * t
        return r + shift, d + np.cross(w, d)

    def jacobian(self, r, d):
        columns = []
        for e in np.eye(4 * (self.n - 1)):
            plus = self.strains(*self.moved(r, d, 1e-6 * e)).real
            columns.append(
                (plus - self.strains(*self.moved(r, d, -1e-6 * e)).real) / 2e-6
            )
        return np.array(columns).T

    def slope(self, y, load):
        """Derivative of (nodes, directors, velocities, spins)."""
        n = self.n - 1
        r = np.vstack([np.zeros(3), y[: 3 * n].reshape(n, 3)])
        d, v, spin = y[3 * n : 6 * n].reshape(n, 3), y[6 * n : 9 * n], y[9 * n :]
        u = np.diff(r, axis=0)
        length = np.linalg.norm(u, axis=1)[:, None]
        t = u / length
        rate = (
            np.cross(t, np.diff(np.vstack([np.zeros(3), v.reshape(n, 3)]), axis=0))
            / length
        )
        b = self.jacobian(r, d)
        stress = self.stiffness * (
            self.strains(r, d).real + self.beta * b @ np.append(v, spin)
        )
        force = -b.T @ stress
        force[3 * (n - 1) : 3 * n] += load
        # The spin's angular momentum turns with the segment: a moment on it, carried by its nodes.
        moment = (self.spin * spin)[:, None] * np.cross(rate, t)
        couple = np.cross(moment, t) / length
        nodes = force[: 3 * n].reshape(n, 3) - couple
        nodes[:-1] += couple[1:]
        return np.concatenate(
            [
                v,
                np.cross(rate + spin[:, None] * t, d).ravel(),
                np.linalg.solve(self.mass, nodes).ravel(),
                force[3 * n :] / self.spin,
            ]
        )


def test_motion_converges_to_an_independent_integration_with_second_order():
    nodes, end, force = 4, 0.02, np.array([0.0, 0.6, -0.5])
    own, rod = Independent(TPU, LEG, nodes), CosseratRod(TPU, LEG, nodes, refined=False)
    state = rod.state
    spin = np.array([0.0, 60.0, -90.0])  # twists the leg
    start = [
        state.position[1:].ravel(),
        state.director.ravel(),
        np.zeros(3 * (nodes - 1)),
        spin,
    ]
    exact = solve_ivp(
        lambda t, y: own.slope(y, force),
        (0, end),
        np.concatenate(start),
        method="Radau",
        rtol=1e-7,
        atol=1e-9,
    )
    tip = exact.y[3 * (nodes - 2) : 3 * (nodes - 1), -1]
    director = exact.y[3 * (nodes - 1) : 6 * (nodes - 1), -1].reshape(-1, 3)
    errors, turns = [], []
    for steps in (20, 40, 80):
        rod.state = RodState(
            state.position,
            state.director,
            state.velocity,
            spin[:, None] * [1.0, 0.0, 0.0],
            state.ends,
        )
        rod.run(end / steps, steps, Loads(force=tuple(force)))
        errors.append(math.dist(rod.state.position[-1], tip))
        turns.append(np.abs(rod.state.director - director).max())
    assert errors[0] / errors[2] > 12  # pure second order gives 16
    assert errors[2] < 2e-5  # m, of a motion of some centimetres
    assert turns[0] / turns[2] > 12
    assert turns[2] < 2e-3


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


def test_turned_clamp_turns_the_rod():
    """Turned by a quarter about an oblique axis, the damped rod rests in its natural shape."""
    axis, steps = np.array([2.0, -1.0, 2.0]) / 3, 400
    material = Material(1e7, 1e7 / 3, 1200.0, 2e-2)
    rod = CosseratRod(material, Geometry(LEG.length, LEG.section, 3.0), 9)
    for n in range(1, steps + 1):
        rod.step(2e-3, base=Pose(rotation=tuple(axis * (math.pi / 2) * n / steps)))
    rod.run(2e-3, 1500)
    turned = CosseratRod(
        material,
        Geometry(LEG.length, LEG.section, 3.0),
        9,
        pose=Pose(rotation=tuple(axis * math.pi / 2)),
    )
    np.testing.assert_allclose(rod.state.position, turned.state.position, atol=1e-8)
    np.testing.assert_allclose(rod.state.ends, turned.state.ends, atol=1e-7)


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


def test_damped_rod_settles_at_its_static_equilibrium():
    loads = Loads(force=(0.0, 0.3, -0.5), gravity=(0.0, 0.0, -9.81))
    material = Material(1e7, 1e7 / 3, 1200.0, 2e-2)
    moved, solved = CosseratRod(material, LEG, 9), CosseratRod(material, LEG, 9)
    moved.run(2e-3, 1500, loads)
    solved.solve_static(loads)
    np.testing.assert_allclose(moved.state.position, solved.state.position, atol=1e-8)
    np.testing.assert_allclose(moved.state.director, solved.state.director, atol=1e-7)
    np.testing.assert_allclose(moved.state.ends, solved.state.ends, atol=1e-7)


@pytest.mark.parametrize("turns", [0.55, 1.2])
def test_rod_twisted_beyond_a_turn_stays_sound_when_kicked_sideways(turns):
    """The tip is turned by more than 180 and 360 deg about the axis, then the middle is kicked."""
    slide = Support((False, True, True), (True, True, True))
    material = Material(1e7, 1e7 / 3, 1200.0, 2e-3)
    rod = CosseratRod(material, Geometry(0.3, Circle((0.02, 0.02))), 21, tip=slide)
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
    even = np.cumsum(np.full(20, 2 * math.pi * turns / 20)) - math.pi * turns / 20
    director = rod.state.director
    expected = np.column_stack([np.zeros(20), -np.cos(even), -np.sin(even)])
    # Evenly but for the hinges' weights at the ends, 3/8, 7/6 and 23/24 of a step.
    assert np.abs(director - expected).max() < 0.3 * 2 * math.pi * turns / 20
    assert np.abs(rod.state.position[:, 1:]).max() < 1e-6


def test_stepping_allocates_no_memory():
    rod = CosseratRod(TPU, LEG, 9)
    loads, record = Loads(force=(0.0, 0.1, 0.1)), np.zeros((0, 3))
    _nrt_python.memsys_enable_stats()
    counts = []
    for steps in (1, 1, 300):
        before = rtsys.get_allocation_stats().alloc
        rod._run(1e-3, steps, loads, record)
        counts.append(rtsys.get_allocation_stats().alloc - before)
    assert (
        counts[1] == counts[2]
    )  # allocations per call, for its arguments, not per step


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
def test_one_newton_iteration_per_step_follows_the_converged_damped_motion(nodes):
    """Released from an oblique force of 1 N, steps of 1 ms."""
    paths = []
    for iterations in (1, 20):
        rod = CosseratRod(TPU, LEG, nodes, scheme=Scheme(iterations=iterations))
        rod.solve_static(Loads(force=(0.0, 0.6, -0.8)))
        start = np.linalg.norm(rod.state.position[-1, 1:])
        paths.append(rod.run(1e-3, 1000, samples=100))
    assert (
        np.abs(paths[0] - paths[1]).max() < 2e-3 * start
    )  # below the error of the time step


@pytest.mark.parametrize(("iterations", "unconverged"), [(1, 50), (20, 0)])
def test_unconverged_steps_are_counted(iterations, unconverged):
    rod = CosseratRod(TPU, LEG, 9, scheme=Scheme(iterations=iterations))
    rod.run(1e-3, 50, Loads(force=(0.0, 0.2, 0.5)))
    assert rod.unconverged == unconverged
