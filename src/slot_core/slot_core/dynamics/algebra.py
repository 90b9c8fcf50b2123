"""Vectors of three numbers, small matrices and rotations in the kernels, written out.

A vector is a tuple of three numbers, or of three Lanes (`lanes.py`); where it is only read it may
be an array (3,). Sums run from left to right: their order decides the last bit.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math

from slot_core.compiled import helper
from slot_core.dynamics.lanes import all_lanes, where
from slot_core.elementary import cos, sin


@helper
def row(a, i):
    """Row i of an array (n, 3) as a vector."""
    return a[i, 0], a[i, 1], a[i, 2]


@helper
def put(a, i, v):
    """Write a vector into row i of an array (n, 3)."""
    a[i, 0] = v[0]
    a[i, 1] = v[1]
    a[i, 2] = v[2]


@helper
def store(out, v):
    """Write a vector into an array (3,)."""
    out[0] = v[0]
    out[1] = v[1]
    out[2] = v[2]


@helper
def add(a, b):
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@helper
def minus(a, b):
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@helper
def scaled(share, v):
    """share v."""
    return share * v[0], share * v[1], share * v[2]


@helper
def plus(a, share, b):
    """a + share b."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@helper
def combined(x, a, y, b, z, c):
    """x a + y b + z c."""
    return (
        x * a[0] + y * b[0] + z * c[0],
        x * a[1] + y * b[1] + z * c[1],
        x * a[2] + y * b[2] + z * c[2],
    )


@helper
def dot(a, b):
    """Scalar product a.b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@helper
def plus_dot(start, a, b):
    """start + a.b, summed from the start on."""
    return start + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@helper
def cross(a, b):
    """Vector product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@helper
def times(m, v):
    """m v for a matrix m (3, 3)."""
    return (
        m[0, 0] * v[0] + m[0, 1] * v[1] + m[0, 2] * v[2],
        m[1, 0] * v[0] + m[1, 1] * v[1] + m[1, 2] * v[2],
        m[2, 0] * v[0] + m[2, 1] * v[1] + m[2, 2] * v[2],
    )


@helper
def times_transposed(m, v):
    """m^T v for a matrix m (3, 3)."""
    return (
        m[0, 0] * v[0] + m[1, 0] * v[1] + m[2, 0] * v[2],
        m[0, 1] * v[0] + m[1, 1] * v[1] + m[2, 1] * v[2],
        m[0, 2] * v[0] + m[1, 2] * v[1] + m[2, 2] * v[2],
    )


@helper
def product(out, a, b):
    """out = a b, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = (
                a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
            )


@helper
def orthonormalise(out, r):
    """out = r (3 I - r^T r) / 2, which removes the rounding errors of a rotation matrix r."""
    for i in range(3):
        for j in range(3):
            value = 1.5 * r[i, j]
            for k in range(3):
                dot = r[0, k] * r[0, j] + r[1, k] * r[1, j] + r[2, k] * r[2, j]
                value -= 0.5 * r[i, k] * dot
            out[i, j] = value


@helper
def rotation(out, w):
    """Write into out (3, 3) the rotation matrix of a vector w, rad, by Rodrigues' formula.

    R = 1 + a [w] + b [w]^2 with a = sin |w| / |w|, b = (1 - cos |w|) / |w|^2.
    """
    x, y, z = w[0], w[1], w[2]
    square = x * x + y * y + z * z
    # series, exact to double precision
    a = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
    b = 0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0))
    small = square < 1e-4
    if not all_lanes(small):
        square = max(1e-12, square)  # no 0 / 0 in a lane at rest
        angle = math.sqrt(square)
        a = where(small, a, sin(angle) / angle)
        b = where(small, b, (1.0 - cos(angle)) / square)
    put(
        out,
        0,
        (1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y),
    )
    put(
        out,
        1,
        (b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x),
    )
    put(
        out,
        2,
        (b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)),
    )


@helper
def cosine_sine(angle):
    """(cos, sin) of an angle, rad; of a small one by series, exact to double precision."""
    square = angle * angle
    if all_lanes(square < 1e-4):
        c = 1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0))
        share = 1.0 - square / 6.0 * (
            1.0 - square / 20.0 * (1.0 - square / 42.0)
        )
        return c, angle * share
    return cos(angle), sin(angle)


@helper
def solve(H, g):
    """Solve H x = -g in place by LDL^T (x replaces g); False when a pivot is not positive.

    Of Lanes four systems; False when a pivot of one of them is not positive.
    """
    definite = True
    n = g.size
    for k in range(n):
        definite = definite and all_lanes(H[k, k] > 0.0)
        for i in range(k + 1, n):
            factor = H[i, k] / H[k, k]
            for j in range(k, n):
                H[i, j] -= factor * H[k, j]
            g[i] -= factor * g[k]
    for k in range(n - 1, -1, -1):
        value = -g[k]
        for j in range(k + 1, n):
            value -= H[k, j] * g[j]
        g[k] = value / H[k, k]
    return definite
