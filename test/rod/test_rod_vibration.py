"""Natural frequencies of the Cosserat rod against closed forms and Ritz's method."""

import math

import numpy as np
import pytest
from rods import OBLONG, UNIT, slender
from scipy.linalg import eig

from benchmarks.rod import exact
from benchmarks.rod.exact import LEG, THIN_MATERIAL, TPU
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import FREE, Geometry, Loads, Rectangle, Uniform

GOALS = [1e-6, 2e-5, 2e-4]  # of the first three frequencies at 31 nodes; fourth order


def nearest(rod, wanted, count=16):
    """Largest relative errors of the frequencies (Hz) that a rod should have among its lowest."""
    found = rod.natural_frequencies(count)
    return np.array([np.abs(found / f - 1).min() for f in wanted])


def test_uniform_cantilever_bends_in_both_planes_as_bernoullis_beam():
    wanted = exact.FREQUENCIES["uniform"] / (2 * math.pi)
    rod = CosseratRod(UNIT, Geometry(1.0, Uniform(1e6, 1.0, 2.0, 1e4)))
    np.testing.assert_array_less(nearest(rod, wanted), GOALS)
    np.testing.assert_array_less(nearest(rod, math.sqrt(2.0) * wanted), GOALS)


def test_uniform_cantilever_twists_at_odd_quarter_waves():
    rod = CosseratRod(UNIT, Geometry(1.0, Uniform(1e6, 1.0, 2.0, 0.8)))
    spin = 1e-6 * 3.0  # density times polar moment
    wanted = (np.arange(3) + 0.5) * math.pi * math.sqrt(0.8 / spin) / (2 * math.pi)
    found = nearest(rod, wanted, count=90)
    np.testing.assert_array_less(
        found, [2e-4, 2e-3, 5e-3]
    )  # lumped spins: second order


def test_tapered_cantilever_has_its_known_frequencies():
    rod = CosseratRod(THIN_MATERIAL, Geometry(1.0, Rectangle(1.0, (1e-3, 5e-4))))
    wanted = exact.FREQUENCIES["tapered"] / (2 * math.pi)
    np.testing.assert_array_less(nearest(rod, wanted), GOALS)


def test_leg_has_its_known_frequencies_in_the_plane():
    found = nearest(CosseratRod(TPU, LEG), exact.FREQUENCIES["leg"])
    np.testing.assert_array_less(found, [2e-6, 3e-5, 2e-4])


def test_leg_bends_sideways_as_in_ritzs_method():
    found = nearest(CosseratRod(TPU, LEG), exact.sideways(TPU, LEG, 3))
    np.testing.assert_array_less(found, [2e-6, 3e-5, 2e-4])


def test_leg_twists_as_in_ritzs_method():
    found = nearest(CosseratRod(TPU, LEG, 61), exact.twisting(TPU, LEG, 2), 40)
    np.testing.assert_array_less(found, [2e-4, 6e-4])  # lumped spins: second order


def test_free_rod_has_six_rigid_modes_and_bernoullis_frequencies():
    rod = CosseratRod(UNIT, OBLONG, base=FREE)
    found = rod.natural_frequencies(10) * 2 * math.pi
    # Error of the squared frequency: rounding of the axial stiffness, 1e-16 * 1e6 * 30^2.
    assert np.abs(found[:6]).max() < 0.1
    plane = np.array([4.7300407449, 7.8532046241]) ** 2
    exact_frequencies = np.sort([*plane, *(math.sqrt(2) * plane)])
    np.testing.assert_allclose(found[6:], exact_frequencies, rtol=1e-4)


@pytest.mark.parametrize(("load", "flutters"), [(19.95, False), (20.15, True)])
def test_column_under_a_follower_force_flutters_beyond_becks_load(load, flutters):
    """Beck (1952): P L^2/(EI) = 20.05; sideways the rod is stiffer."""
    rod, loads = slender(), Loads(follower=(-load, 0.0, 0.0))
    rod.solve_static(loads)
    free = np.ix_(rod.free_unknowns(), rod.free_unknowns())
    flexibility = eig(rod.mass_matrix()[free], rod.tangent(loads)[free], right=False)
    lowest = flexibility[
        np.argsort(-np.abs(flexibility))[:2]
    ]  # 1 / omega^2; 0 without mass
    assert (np.abs(lowest.imag).max() > 1e-3 * np.abs(lowest).max()) == flutters
