"""Products, inverses and interpolation of small matrices against NumPy's.

Elementary functions against mpmath's, and their limits.
"""

import math

import mpmath
import numpy as np
import pytest
from scipy import sparse

from slot_core.elementary import LARGEST, atan2, cos, exp, hypot, log, sin
from slot_core.matrices import (
    interpolated,
    inverse,
    norm,
    product,
    sparse_product,
)

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ((3, 3), (3, 3)),
        ((2, 7), (7, 4)),
        ((7,), (7, 4)),
        ((2, 7), (7,)),
        ((5,), (5,)),
    ],
)
def test_products_are_those_of_matrices_and_vectors(left, right):
    a, b = RNG.normal(size=left), RNG.normal(size=right)
    np.testing.assert_allclose(product(a, b), a @ b, rtol=1e-14, atol=1e-14)
    assert np.shape(product(a, b)) == np.shape(a @ b)
    # whatever its layout
    np.testing.assert_array_equal(product(a.T.copy().T, b), product(a, b))


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"\(2, 3\) and \(2, 3\)"):
        product(np.ones((2, 3)), np.ones((2, 3)))


def test_sparse_products_and_norms_are_those_of_scipy_and_numpy():
    a, x = (
        sparse.random(40, 30, 0.2, format="csc", rng=RNG),
        RNG.normal(size=30),
    )
    np.testing.assert_allclose(sparse_product(a, x), a @ x, atol=1e-14)
    b = RNG.normal(size=(4, 3))
    np.testing.assert_allclose(norm(b), np.linalg.norm(b, axis=1))
    assert isinstance(norm(b[0]), float)


def test_the_inverse_of_a_definite_matrix_and_nan_for_another():
    root = RNG.normal(size=(25, 25))
    a = root @ root.T + np.eye(25)
    np.testing.assert_allclose(inverse(a) @ a, np.eye(25), atol=1e-11)
    np.testing.assert_array_equal(inverse(a), inverse(a).T)
    assert np.isnan(inverse(-np.eye(2))).any()


def test_interpolation_is_that_of_numpy_also_on_plateaus_beyond_the_grid_and_at_nan():
    grid = np.array([0.0, 1.0, 1.0, 2.0, 2.0])
    values = np.array([3.0, 1.0, 2.0, 5.0, 6.0])
    x = np.array([-1.0, 0.0, 0.3, 1.0, 1.5, 2.0, 3.0, np.nan])
    np.testing.assert_allclose(
        interpolated(x, grid, values), np.interp(x, grid, values)
    )
    assert isinstance(interpolated(0.5, grid, values), float)


COUNT = 3000
ANGLES = np.concatenate(
    [
        RNG.uniform(-1, 1, COUNT),
        RNG.uniform(-10, 10, COUNT),
        RNG.uniform(-LARGEST, LARGEST, COUNT),
        np.pi / 2 * np.arange(-1000, 1000),  # next to zeros
        np.pi / 2 * RNG.integers(-600_000, 600_000, COUNT),
        10.0 ** RNG.uniform(-300, 0, COUNT),
    ]
)
POINTS = np.concatenate(
    [
        RNG.uniform(-1, 1, (COUNT, 2)),
        10.0 ** RNG.uniform(-150, 150, (COUNT, 2))
        * RNG.choice([-1, 1], (COUNT, 2)),
        # at the table's grid
        np.column_stack([np.arange(1, 1025) / 1024, np.ones(1024)]),
        RNG.uniform(0.9, 1.1, (COUNT, 2)) * [1e-3, -1.0],
    ]
)
ONE_ULP = {
    "sin": (sin, mpmath.sin, (ANGLES,)),
    "cos": (cos, mpmath.cos, (ANGLES,)),
    "atan2": (atan2, mpmath.atan2, tuple(POINTS.T)),
    "exp": (
        exp,
        mpmath.exp,
        (np.append(RNG.uniform(-700, 700, COUNT), ANGLES[:COUNT]),),
    ),
    "log": (
        np.vectorize(log.py_func),
        mpmath.log,
        (
            np.append(
                10.0 ** RNG.uniform(-300, 300, COUNT),
                RNG.uniform(0.5, 2, COUNT),
            ),
        ),
    ),
}


@pytest.mark.parametrize("name", ONE_ULP)
def test_error_is_at_most_one_unit_in_the_last_place(name):
    function, exact, arguments = ONE_ULP[name]
    with mpmath.workprec(400):
        for found, *numbers in zip(function(*arguments), *arguments):
            wanted = exact(*(mpmath.mpf(float(number)) for number in numbers))
            assert abs(mpmath.mpf(float(found)) - wanted) <= math.ulp(
                float(wanted)
            ), numbers


@pytest.mark.parametrize("y", [0.0, -0.0, 1.0, -1.0, 5e-324, 1e300])
@pytest.mark.parametrize("x", [0.0, -0.0, 1.0, -1.0, -5e-324, 1e300])
def test_angles_at_axes_and_limits_are_those_of_the_c_library(y, x):
    found, wanted = atan2(y, x), math.atan2(y, x)
    assert found == pytest.approx(wanted, rel=2.3e-16, abs=0)
    assert math.copysign(1.0, found) == math.copysign(1.0, wanted)


def test_what_is_no_angle_is_nan():
    for function in (sin, cos):
        assert np.isnan(
            function(np.array([np.nan, np.inf, 1.1 * LARGEST]))
        ).all()
    y, x = np.array([np.nan, 1.0, np.inf]), np.array([1.0, np.nan, 1.0])
    assert np.isnan(atan2(y, x)).all()


def test_numbers_give_floats_and_arrays_their_shape():
    assert all(isinstance(value, float) for value in (sin(1), atan2(1, 2)))
    assert atan2(np.zeros((2, 1)), np.ones(3)).shape == (2, 3)
    assert (hypot(3.0, 4.0), exp(0.0), log.py_func(1.0)) == (5.0, 1.0, 0.0)
