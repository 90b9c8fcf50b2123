"""References of the rod's benchmark against independent derivations; comparison with peers."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import jv

from benchmarks import harness
from benchmarks.rod import exact, release


def shoot(
    moment_rate, base_moment, stretch=lambda s, a: (1.0, 0.0), bending=lambda s: 1.0, end=1.0
):
    """State (angle, M, x, y) at the tip by Runge-Kutta from a clamp with a given moment.

    M' = moment_rate(s, angle, x', y'), angle' = M / bending(s), and stretch(s, angle) is the
    tangent's length along and across the section.
    """

    def slope(s, state):
        along, across = stretch(s, state[0])
        c, d = math.cos(state[0]), math.sin(state[0])
        x, y = c * along - d * across, d * along + c * across
        return [state[1] / bending(s), moment_rate(s, state[0], x, y), x, y]

    found = solve_ivp(slope, (0, end), [0, base_moment, 0, 0], "DOP853", rtol=1e-11, atol=1e-13)
    return found.y[:, -1]


def tip_by_shooting(farthest, moment_rate, **options):
    """Tip (x, y) for the base moment, between 0 and `farthest`, with zero moment at the tip."""

    def tip_moment(moment):
        return shoot(moment_rate, moment, **options)[1]

    moment = brentq(tip_moment, 0.0, farthest, xtol=1e-13)
    return shoot(moment_rate, moment, **options)[2:]


@pytest.mark.parametrize("p", [0.2, 1.0, 3.0, 10.0])
def test_elastica_by_elliptic_integrals_agrees_with_shooting(p):
    shot = tip_by_shooting(p, lambda s, a, x, y: -p * math.cos(a))
    np.testing.assert_allclose(exact.elastica(p), shot, atol=1e-9)


@pytest.mark.parametrize("p", [1.0, 3.0, 10.0])
def test_follower_force_by_elliptic_integrals_agrees_with_integration_from_the_tip(p):
    """From the tip there is no unknown: the force is normal to the tip, the moment is zero.

    The integration starts at the tip, along x with the force along y, and ends at the clamp, whose
    pose gives the tip in the clamp's frame.
    """

    def slope(_, state):
        c, s = math.cos(state[0]), math.sin(state[0])
        return [-state[1], p * c, -c, -s]

    found = solve_ivp(slope, (0, 1), [0, 0, 0, 0], "DOP853", rtol=1e-11, atol=1e-13)
    angle, _, x, y = found.y[:, -1]
    c, s = math.cos(angle), math.sin(angle)
    np.testing.assert_allclose(exact.follower(p), [-c * x - s * y, s * x - c * y], atol=1e-9)


@pytest.mark.parametrize("w", [1.0, 10.0, 50.0])
def test_heavy_elastica_by_collocation_agrees_with_shooting_from_the_tip(w):
    """From the tip, by t: a' = -M, M' = -w t cos a; the tip's angle makes the clamp's zero."""

    def back(angle):
        def slope(t, state):
            c, s = math.cos(state[0]), math.sin(state[0])
            return [-state[1], -w * t * c, c, s]

        return solve_ivp(slope, (0, 1), [angle, 0, 0, 0], "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]

    angle = brentq(lambda a: back(a)[0], -math.pi / 2, 0.0, xtol=1e-14)
    np.testing.assert_allclose(exact.heavy(w), back(angle)[2:], atol=1e-7)


def test_elastica_under_a_small_weight_sags_by_an_eighth_of_it():
    w = 1e-3
    assert exact.heavy(w)[1] == pytest.approx(
        -w / 8, rel=1e-5
    )  # second order: the slope squared, w^2 / 36


def test_greenhills_load_is_the_first_zero_of_the_bessel_function():
    zero = brentq(lambda x: jv(-1 / 3, x), 1.0, 3.0, xtol=1e-14)
    assert math.isclose(exact.GREENHILL, 9 / 4 * zero**2, rel_tol=1e-12)


def test_greenhills_load_is_the_least_of_the_rayleigh_quotient():
    """EI a'' + w (1 - s) a = 0 for the angle a, in sines with a' = 0 at the tip."""
    count = 12
    mode = [(k + 0.5) * math.pi for k in range(count)]
    weight = [
        [
            quad(lambda s, i=i, j=j: (1 - s) * math.sin(i * s) * math.sin(j * s), 0, 1)[0]
            for j in mode
        ]
        for i in mode
    ]
    values = eigh(weight, np.diag(np.square(mode)) / 2, eigvals_only=True)
    assert math.isclose(exact.GREENHILL, 1 / values[-1], rel_tol=1e-6)


@pytest.mark.parametrize(
    ("shear", "stretches", "drop"),
    [(True, True, 87.585), (False, True, 87.376), (False, False, 87.306)],
)
def test_leg_by_collocation_agrees_with_shooting(shear, stretches, drop):
    """`drop` in mm; shooting also gives that of a leg that only bends."""
    leg, tpu, p = exact.LEG, exact.TPU, exact.PUSH.force[1]

    def stretch(s, angle):
        area = leg.section.area(s / leg.length)
        across = p * math.cos(angle) / (5 / 6 * tpu.shear_modulus * area) * shear
        return 1 + p * math.sin(angle) / (tpu.young_modulus * area) * stretches, across

    def bending(s):
        return tpu.young_modulus * leg.section.second_moment(s / leg.length)

    shot = tip_by_shooting(
        p * leg.length, lambda s, a, x, y: -x * p,
        stretch=stretch, bending=bending, end=leg.length,
    )  # fmt: skip
    assert -1e3 * shot[1] == pytest.approx(drop, abs=5e-4)
    if stretches:
        np.testing.assert_allclose(exact.leg_tip(shear), shot, atol=1e-9)


def test_leg_under_a_small_force_has_timoshenkos_flexibility():
    """Flexibility of the tapered leg: integral of (L - s)^2 / EI + 1 / kappa GA."""
    leg, tpu = exact.LEG, exact.TPU
    p = 1e-4

    def flexibility(s):
        f = s / leg.length
        bend = (leg.length - s) ** 2 / (tpu.young_modulus * leg.section.second_moment(f))
        return bend + 1 / (5 / 6 * tpu.shear_modulus * leg.section.area(f))

    tip = exact.collocation(
        exact.dead(p),
        lambda s: tpu.young_modulus * leg.section.second_moment(s / leg.length),
        lambda s: tpu.young_modulus * leg.section.area(s / leg.length),
        lambda s: 5 / 6 * tpu.shear_modulus * leg.section.area(s / leg.length),
        leg.length,
    )
    assert tip[1] / p == pytest.approx(quad(flexibility, 0, leg.length)[0], rel=1e-6)


def row(percent, cost, simulator="peer"):
    return {"simulator": simulator, "percent": percent, "cpu_s": cost, "physics": "any"}


@pytest.mark.parametrize(
    ("own", "rivals", "ratio"),
    [
        (row(0.1, 1.0), [row(0.4, 8.0), row(0.05, 20.0), row(0.6, 2.0)], 8.0),  # within 0.5 %
        (
            row(0.9, 1.0),
            [row(0.4, 8.0), row(0.8, 5.0), row(2.0, 2.0)],
            5.0,
        ),  # within the error of `own`
        (
            row(0.1, 1.0),
            [row(3.0, 8.0), row(2.0, 9.0), row(math.nan, math.nan)],
            9.0,
        ),  # the most accurate
    ],
)
def test_peer_is_represented_by_its_fastest_row_that_is_accurate_enough(own, rivals, ratio):
    check = release.rival_check("peer", own, rivals, 5.0)
    assert check.value == pytest.approx(ratio)
    assert check.holds


@pytest.mark.parametrize("rivals", [[], [row(math.nan, math.nan)]])
def test_peer_without_a_result_does_not_hold(rivals):
    assert not release.rival_check("peer", row(0.1, 1.0), rivals, 5.0).holds


def test_front_holds_the_rows_that_none_of_the_same_physics_dominates():
    rows = [row(1.0, 1.0), row(2.0, 0.5), row(1.5, 2.0), row(math.nan, 0.1)]
    rows.append({**row(9.0, 9.0), "physics": "other"})
    release.mark_front(rows)
    assert [bool(each["front"]) for each in rows] == [True, True, False, False, True]


def test_every_setting_of_the_checks_is_measured():
    measured = {
        physics: {
            (r["nodes"], r["h"])
            for r in planned(physics)
            if (r["theta"], r["iterations"]) == (0.5, 1)
        }
        for physics in (release.DAMPED, release.DAMPED_SHEAR, release.UNDAMPED_SHEAR)
    }
    checked = [
        *itertools.chain(*release.GOALS),
        *(setting for setting, _ in release.RIVALS.values()),
    ]
    assert all((s.nodes, s.h) in measured[s.physics] for s in checked)


def planned(physics):
    """Settings of CosseratRod that a quick run measures."""
    rows = []
    original = release.own_row
    try:
        release.own_row = lambda _, __, elements, h, scheme, ___: rows.append(
            {
                "nodes": 2 * elements + 1,
                "h": h,
                "theta": scheme.theta,
                "iterations": scheme.iterations,
            }
        )
        release.own_rows(physics, np.zeros(0), True, 1)
    finally:
        release.own_row = original
    return rows


def test_rod_needs_both_peers():
    source = harness.known(harness.ROOT / "scripts" / "benchmarks")["rod"].read_text()
    assert 'REQUIRES = ("mujoco", "elastica")' in source.splitlines()
