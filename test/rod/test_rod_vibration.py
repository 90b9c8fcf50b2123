"""Natural frequencies of the Cosserat rod against closed forms and Ritz's method."""

import math

import numpy as np
import pytest
from rods import OBLONG, UNIT, slender
from scipy.linalg import eig

from benchmarks.rod import exact
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import FREE, Geometry, Loads, Rectangle, Uniform
from slot_core.rod.statics import free_unknowns

BENDING = [1e-6, 2e-5, 2e-4]  # fourth order
UNIFORM, TAPERED = (
    exact.FREQUENCIES[name] / (2 * math.pi) for name in ("uniform", "tapered")
)
SPIN = 1e-6 * 3.0  # density times polar moment
QUARTER_WAVES = (np.arange(3) + 0.5) * math.sqrt(0.8 / SPIN) / 2


def uniform(torsion):
    return CosseratRod(UNIT, Geometry(1.0, Uniform(1e6, 1.0, 2.0, torsion)))


# Rod, its lowest frequencies (Hz), how many to find, relative errors. Spins are lumped: twisting is
# of second order. The leg sideways and in twist: Ritz's method.
RODS = {
    "uniform": (uniform(1e4), UNIFORM, 16, BENDING),
    "uniform, sideways": (uniform(1e4), math.sqrt(2.0) * UNIFORM, 16, BENDING),
    "uniform, twist": (uniform(0.8), QUARTER_WAVES, 90, [2e-4, 2e-3, 5e-3]),
    "tapered": (
        CosseratRod(
            exact.THIN_MATERIAL, Geometry(1.0, Rectangle(1.0, (1e-3, 5e-4)))
        ),
        TAPERED,
        16,
        BENDING,
    ),
    "leg": (
        CosseratRod(exact.TPU, exact.LEG),
        exact.FREQUENCIES["leg"],
        16,
        [2e-6, 3e-5, 2e-4],
    ),
    "leg, sideways": (
        CosseratRod(exact.TPU, exact.LEG),
        exact.sideways(exact.TPU, exact.LEG, 3),
        16,
        [2e-6, 3e-5, 2e-4],
    ),
    "leg, twist": (
        CosseratRod(exact.TPU, exact.LEG, 61),
        exact.twisting(exact.TPU, exact.LEG, 2),
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
    rod = CosseratRod(UNIT, OBLONG, base=FREE)
    found = rod.natural_frequencies(10) * 2 * math.pi
    # Error of the squared frequency: rounding of the axial stiffness, 1e-16 * 1e6 * 30^2.
    assert np.abs(found[:6]).max() < 0.1
    plane = np.array([4.7300407449, 7.8532046241]) ** 2
    exact_frequencies = np.sort([*plane, *(math.sqrt(2) * plane)])
    np.testing.assert_allclose(found[6:], exact_frequencies, rtol=1e-4)


@pytest.mark.parametrize(("load", "flutters"), [(19.95, False), (20.15, True)])
def test_column_under_a_follower_force_flutters_beyond_becks_load(
    load, flutters
):
    """Beck (1952): P L^2/(EI) = 20.05; sideways the rod is stiffer."""
    rod, loads = slender(), Loads(follower=(-load, 0.0, 0.0))
    rod.solve_static(loads)
    free = np.ix_(free_unknowns(rod.mesh), free_unknowns(rod.mesh))
    flexibility = eig(
        rod.mass_matrix()[free], rod.tangent(loads)[free], right=False
    )
    # 1 / omega^2; 0 without mass
    lowest = flexibility[np.argsort(-np.abs(flexibility))[:2]]
    assert (np.abs(lowest.imag).max() > 1e-3 * np.abs(lowest).max()) == flutters
