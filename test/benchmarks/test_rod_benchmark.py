"""References of the rod's benchmark against independent derivations; MuJoCo's chain."""

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from benchmarks.rod import exact
from slot_core.rod.model import Geometry, Loads, Material, Uniform


def integrated(slope, start):
    """State at the end of the unit length, by Runge-Kutta of eighth order."""
    return solve_ivp(slope, (0, 1), start, "DOP853", rtol=1e-11, atol=1e-13).y[
        :, -1
    ]


@pytest.mark.parametrize("p", [0.2, 10.0])
def test_elastica_by_elliptic_integrals_agrees_with_shooting(p):
    """From the clamp: angle' = M, M' = -p cos angle; the clamp's moment makes the tip's zero."""

    def tip(moment):
        def slope(_, state):
            c, s = math.cos(state[0]), math.sin(state[0])
            return [state[1], -p * c, c, s]

        return integrated(slope, [0, moment, 0, 0])

    moment = brentq(lambda m: tip(m)[1], 0.0, p, xtol=1e-13)
    np.testing.assert_allclose(exact.elastica(p), tip(moment)[2:], atol=1e-9)


def test_leg_under_a_small_force_has_bernoullis_flexibility_in_both_planes():
    """Flexibility of the tapered leg: integral of (L - s)^2 / EI."""
    leg, tpu, p = exact.LEG, exact.TPU, 1e-4
    tip = exact.tip(tpu, leg, Loads(force=(0.0, p, p)))
    for found, moment in (
        (tip[1], leg.section.lateral_moment),
        (tip[2], leg.section.second_moment),
    ):

        def part(s, moment=moment):
            return (leg.length - s) ** 2 / (
                tpu.young_modulus * moment(s / leg.length)
            )

        assert found / p == pytest.approx(
            quad(part, 0, leg.length)[0], rel=1e-6
        )


def test_ritzs_method_gives_the_known_frequencies_of_uniform_rods():
    material, unit = Material(1.0, 1.0, 1.0, 0.0), Uniform(1.0, 0.5, 1.0, 0.75)
    geometry, turn = Geometry(1.0, unit), 2 * math.pi
    found = exact.sideways(material, geometry, 3) * turn
    np.testing.assert_allclose(found, exact.FREQUENCIES["uniform"], rtol=1e-9)
    wanted = (np.arange(3) + 0.5) * math.pi * math.sqrt(0.75 / 1.5)
    found = exact.twisting(material, geometry, 3) * turn
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
