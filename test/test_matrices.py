"""Products, inverses and interpolation of small matrices against NumPy's."""

import numpy as np
import pytest
from scipy import sparse

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
