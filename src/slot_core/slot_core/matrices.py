"""Small matrices with the same bits on every processor: one order of summation, nothing fused.

BLAS and LAPACK choose their code by processor, and so do `@`, `dot` and `einsum` of NumPy. The
helpers are for kernels; the functions below them take arrays.
"""

# mypy: disable-error-code="no-untyped-def"

import math
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.compiled import helper, kernel


@helper
def set_product(out, a, b):
    """out = a b."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            out[i, j] = 0.0
        for k in range(a.shape[1]):
            factor = a[i, k]
            if factor != 0.0:
                for j in range(b.shape[1]):
                    out[i, j] += factor * b[k, j]


@helper
def set_product_transposed(out, a, b):
    """out = a b^T."""
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            value = 0.0
            for k in range(a.shape[1]):
                value += a[i, k] * b[j, k]
            out[i, j] = value


@helper
def inner(a, b):
    """Scalar product of two arrays (n,), summed from the first element on."""
    value = 0.0
    for i in range(a.size):
        value += a[i] * b[i]
    return value


@helper
def cholesky(a):
    """Replace the lower triangle of a by its Cholesky factor L, a = L L^T; NaN if there is none."""
    for j in range(a.shape[0]):
        for i in range(j, a.shape[0]):
            value = a[i, j]
            for k in range(j):
                value -= a[i, k] * a[j, k]
            a[i, j] = value / a[j, j] if i > j else math.sqrt(value)


@helper
def solve_cholesky(factor, x):
    """Replace x (n,) by the solution of L L^T x = x."""
    n = x.shape[0]
    for i in range(n):
        for k in range(i):
            x[i] -= factor[i, k] * x[k]
        x[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= factor[k, i] * x[k]
        x[i] /= factor[i, i]


@kernel
def _multiply(a, b, out):
    """out = a b."""
    set_product(out, a, b)


@kernel
def invert(a, inverse):
    """Write the inverse of a symmetric positive definite a; a is overwritten, NaN if it is not."""
    cholesky(a)
    for j in range(a.shape[0]):
        for i in range(a.shape[0]):
            inverse[j, i] = 1.0 if i == j else 0.0
        solve_cholesky(a, inverse[j])
    for i in range(a.shape[0]):
        for j in range(i):
            inverse[i, j] = inverse[j, i]


@kernel
def _interpolate(x, grid, values, out):
    """Linear interpolation at each of x (m,), written into out (m,)."""
    last = grid.size - 1
    for i in range(x.size):
        low, high = 0, last
        while high - low > 1:
            middle = (low + high) // 2
            if x[i] < grid[middle]:
                high = middle
            else:
                low = middle
        if x[i] <= grid[0]:
            out[i] = values[0]
        elif x[i] >= grid[last]:
            out[i] = values[last]
        else:
            share = (x[i] - grid[low]) / (grid[high] - grid[low])
            out[i] = (1.0 - share) * values[low] + share * values[high]


def product(a: Any, b: Any) -> Any:
    """Product of two matrices, or of a matrix and a vector on either side, or of two vectors."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    left = np.ascontiguousarray(a if a.ndim == 2 else a[None])
    right = np.ascontiguousarray(b if b.ndim == 2 else b[:, None])
    if left.shape[1] != right.shape[0]:
        raise ValueError(f"product of {a.shape} and {b.shape}")
    out = np.empty((left.shape[0], right.shape[1]))
    _multiply(left, right, out)
    if a.ndim == 2 and b.ndim == 2:
        return out
    return out.ravel() if a.ndim == 2 or b.ndim == 2 else float(out[0, 0])


def sparse_product(matrix: Any, vector: Array) -> Array:
    """Product of a matrix in SciPy's CSC format and a vector; sums go along the columns."""
    products = (
        matrix.data
        * vector[np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))]
    )
    return np.asarray(
        np.bincount(matrix.indices, products, matrix.shape[0]), dtype=float
    )


def inverse(a: Array) -> Array:
    """Inverse of a symmetric positive definite matrix; NaN of another one."""
    out = np.empty_like(a)
    invert(np.array(a, dtype=float, order="C"), out)
    return out


@kernel
def _length(a):
    """`norm` of a vector (n,)."""
    return math.sqrt(inner(a, a))


def norm(a: Any) -> Any:
    """Euclidean norm along the last axis."""
    a = np.array(a, dtype=float)
    if a.ndim == 1 and a.size < 8:  # NumPy sums so few in their order too
        return _length(a)
    length = np.sqrt((a * a).sum(axis=-1))
    return length if a.ndim > 1 else float(length)


def interpolated(x: Any, grid: Any, values: Any) -> Any:
    """Linear interpolation of values (n,) on a grid (n,) that does not fall; a float for a number.

    Beyond the grid the value at its edge; NaN gives NaN.
    """
    at = np.array(x, dtype=float, order="C")
    out = np.empty(at.shape)
    grid, values = (
        np.ascontiguousarray(grid, float),
        np.ascontiguousarray(values, float),
    )
    _interpolate(at.ravel(), grid, values, out.ravel())
    return out if out.ndim else float(out)
