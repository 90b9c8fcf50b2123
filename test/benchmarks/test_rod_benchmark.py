"""References of the rod's benchmark against independent derivations; comparison with peers."""

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq, root
from scipy.special import jv

from benchmarks.rod import exact, release, statics
from slot_core.rod.model import Geometry, Loads, Material, Uniform


def integrated(slope, start):
    """State at the end of the unit length, by Runge-Kutta of eighth order."""
    return solve_ivp(slope, (0, 1), start, "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]


@pytest.mark.parametrize("p", [0.2, 1.0, 3.0, 10.0])
def test_elastica_by_elliptic_integrals_agrees_with_shooting(p):
    """From the clamp: angle' = M, M' = -p cos angle; the clamp's moment makes the tip's zero."""

    def tip(moment):
        def slope(_, state):
            c, s = math.cos(state[0]), math.sin(state[0])
            return [state[1], -p * c, c, s]

        return integrated(slope, [0, moment, 0, 0])

    moment = brentq(lambda m: tip(m)[1], 0.0, p, xtol=1e-13)
    np.testing.assert_allclose(exact.elastica(p), tip(moment)[2:], atol=1e-9)


@pytest.mark.parametrize("p", [1.0, 3.0, 10.0])
def test_follower_force_by_elliptic_integrals_agrees_with_integration_from_the_tip(p):
    """From the tip there is no unknown: the force is normal to the tip, the moment is zero.

    The integration starts at the tip, along x with the force along y, and ends at the clamp, whose
    pose gives the tip in the clamp's frame.
    """

    def slope(_, state):
        c, s = math.cos(state[0]), math.sin(state[0])
        return [-state[1], p * c, -c, -s]

    angle, _, x, y = integrated(slope, [0, 0, 0, 0])
    c, s = math.cos(angle), math.sin(angle)
    np.testing.assert_allclose(
        exact.follower(p), [-c * x - s * y, s * x - c * y], atol=1e-9
    )


@pytest.mark.parametrize("w", [1.0, 10.0, 50.0])
def test_heavy_elastica_by_collocation_agrees_with_shooting_from_the_tip(w):
    """From the tip, by t: a' = -M, M' = -w t cos a; the tip's angle makes the clamp's zero."""

    def back(angle):
        def slope(t, state):
            c, s = math.cos(state[0]), math.sin(state[0])
            return [-state[1], -w * t * c, c, s]

        return integrated(slope, [angle, 0, 0, 0])

    angle = brentq(lambda a: back(a)[0], -math.pi / 2, 0.0, xtol=1e-14)
    np.testing.assert_allclose(exact.heavy(w), back(angle)[2:], atol=1e-7)


def test_greenhills_and_prandtls_loads_are_the_first_zeros_of_bessel_functions():
    column, lateral = (
        brentq(lambda x, n=n: jv(-1 / n, x), 1.0, 3.0, xtol=1e-14) for n in (3, 4)
    )
    assert math.isclose(exact.GREENHILL, 9 / 4 * column**2, rel_tol=1e-12)
    assert math.isclose(exact.LATERAL, 2 * lateral, rel_tol=1e-5)


def shot(material, geometry, force, steps=4000):
    """Tip of a cantilever by shooting: the moment at the clamp makes that at the tip zero.

    Fourth-order Runge-Kutta on rotation matrices, written without the equations of exact.py.
    """
    section, length = geometry.section, geometry.length
    ds, force = length / steps, np.array(force)
    at = np.linspace(0.0, 1.0, 2 * steps + 1)
    curvature = geometry.curvature_at(at * length)
    area = material.young_modulus * section.area(at)
    stiffness = np.array(
        [
            material.shear_modulus * section.torsion_constant(at),
            material.young_modulus * section.second_moment(at),
            material.young_modulus * section.lateral_moment(at),
        ]
    ).T

    def rate(i, r, frame, moment):
        tangent = frame[:, 0] * (1 + frame[:, 0] @ force / area[i])
        x, y, z = frame.T @ moment / stiffness[i] - np.array([0.0, curvature[i], 0.0])
        spin = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return tangent, frame @ spin, np.cross(force, tangent)

    def tip(moment):
        y = (np.zeros(3), np.eye(3), np.array(moment))
        for k in range(steps):
            a = rate(2 * k, *y)
            b = rate(2 * k + 1, *(u + ds / 2 * v for u, v in zip(y, a)))
            c = rate(2 * k + 1, *(u + ds / 2 * v for u, v in zip(y, b)))
            d = rate(2 * k + 2, *(u + ds * v for u, v in zip(y, c)))
            y = [
                u + ds / 6 * (p + 2 * q + 2 * r + s)
                for u, p, q, r, s in zip(y, a, b, c, d)
            ]
        return y

    straight = np.cross([length, 0.0, 0.0], force)
    moment = root(
        lambda m: tip(m)[2], 0.9 * straight, tol=1e-11 * np.linalg.norm(straight)
    ).x
    return tip(moment)[0]


@pytest.mark.parametrize("case", ["oblique force", "sideways force, curved", "leg"])
def test_collocation_in_space_agrees_with_shooting(case):
    material, geometry, loads = statics.SPATIAL[case]
    found = shot(material, geometry, loads.force, steps=400)
    np.testing.assert_allclose(
        exact.tip(material, geometry, loads), found, atol=1e-8 * geometry.length
    )


def test_leg_in_its_plane_has_the_deflection_without_shear():
    """Shear adds .209 mm to 87.376, stretch .070 to the 87.306 mm of a leg that only bends."""
    tip = exact.tip(exact.TPU, exact.LEG, Loads(force=(0.0, 0.0, -1.0)))
    assert -1e3 * tip[2] == pytest.approx(87.376, abs=5e-4)


def test_leg_under_a_small_force_has_bernoullis_flexibility_in_both_planes():
    """Flexibility of the tapered leg: integral of (L - s)^2 / EI."""
    leg, tpu, p = exact.LEG, exact.TPU, 1e-4
    tip = exact.tip(tpu, leg, Loads(force=(0.0, p, p)))
    for found, moment in (
        (tip[1], leg.section.lateral_moment),
        (tip[2], leg.section.second_moment),
    ):
        wanted = quad(
            lambda s, moment=moment: (
                (leg.length - s) ** 2 / (tpu.young_modulus * moment(s / leg.length))
            ),
            0,
            leg.length,
        )[0]
        assert found / p == pytest.approx(wanted, rel=1e-6)


def test_ritzs_method_gives_the_known_frequencies_of_uniform_rods():
    material, unit = Material(1.0, 1.0, 1.0, 0.0), Uniform(1.0, 0.5, 1.0, 0.75)
    geometry, turn = Geometry(1.0, unit), 2 * math.pi
    found = exact.sideways(material, geometry, 3) * turn
    np.testing.assert_allclose(found, exact.FREQUENCIES["uniform"], rtol=1e-9)
    wanted = (np.arange(3) + 0.5) * math.pi * math.sqrt(0.75 / 1.5)
    np.testing.assert_allclose(
        exact.twisting(material, geometry, 3) * turn, wanted, rtol=1e-9
    )


def row(percent, cost, simulator="peer"):
    return {"simulator": simulator, "percent": percent, "cpu_s": cost, "physics": "any"}


@pytest.mark.parametrize(
    ("own", "rivals", "ratio"),
    [
        (
            row(0.1, 1.0),
            [row(0.1, 8.0), row(0.05, 20.0), row(0.6, 2.0)],
            8.0,
        ),  # equal error
        (
            row(0.1, 1.0),
            [row(0.2, 4.0), row(0.05, 16.0), row(0.1, 20.0)],
            8.0,
        ),  # between two
        (
            row(0.1, 2.0),
            [row(3.0, 8.0), row(2.0, 12.0), row(math.nan, math.nan)],
            6.0,
        ),  # nearest
        (
            row(4.0, 1.0),
            [row(3.0, 8.0), row(2.0, 12.0)],
            8.0,
        ),  # all of them are more exact
        (row(0.1, 1.0), [], math.nan),
    ],
)
def test_a_peer_costs_what_it_does_at_our_error(own, rivals, ratio):
    check = release.rival_check("peer", own, rivals, 5.0)
    assert check.value == pytest.approx(ratio, nan_ok=True)
    assert check.holds == (ratio > 5.0)


def test_front_holds_the_rows_that_none_of_the_same_simulator_and_physics_dominates():
    rows = [row(1.0, 1.0), row(2.0, 0.5), row(1.5, 2.0), row(math.nan, 0.1)]
    rows.append({**row(9.0, 9.0), "physics": "other"})
    rows.append(row(8.0, 8.0, simulator="another"))
    release.mark_fronts(rows)
    assert [bool(each["front"]) for each in rows] == [
        True,
        True,
        False,
        False,
        True,
        True,
    ]


def test_mujocos_links_weigh_as_much_as_the_leg():
    chain = pytest.importorskip("mujoco").MjModel.from_xml_string(
        pytest.importorskip("benchmarks.rod.mujoco_chain").description(7, 1e-3)
    )
    leg, tpu = exact.LEG, exact.TPU
    mass = quad(lambda f: tpu.density * leg.section.area(f) * leg.length, 0, 1)[0]
    assert chain.body_mass.sum() == pytest.approx(mass, rel=1e-9)
