"""Products, rotations and a linear solver for small matrices in the kernels, written out."""

# mypy: disable-error-code="no-untyped-def"

import math

from slot_core.compiled import helper
from slot_core.dynamics.lanes import all_lanes
from slot_core.elementary import cos, sin


@helper
def times(m, x, y, z):
    """m (3, 3) times the vector (x, y, z)."""
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z,
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z,
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z,
    )


@helper
def times_transposed(m, x, y, z):
    """The transpose of m (3, 3) times the vector (x, y, z)."""
    return (
        m[0, 0] * x + m[1, 0] * y + m[2, 0] * z,
        m[0, 1] * x + m[1, 1] * y + m[2, 1] * z,
        m[0, 2] * x + m[1, 2] * y + m[2, 2] * z,
    )


@helper
def product(out, a, b):
    """out = a b, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


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
def rotation(out, wx, wy, wz):
    """Write into out (3, 3) the rotation matrix of the vector w, rad (Rodrigues' formula)."""
    square = wx * wx + wy * wy + wz * wz
    if all_lanes(square < 1e-4):  # series, exact to double precision
        a = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
        b = 0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0))
    else:
        square = max(1e-12, square)  # no 0 / 0 in a lane at rest
        angle = math.sqrt(square)
        a, b = sin(angle) / angle, (1.0 - cos(angle)) / square
    out[0, 0], out[0, 1], out[0, 2] = (
        1.0 - b * (wy * wy + wz * wz),
        b * wx * wy - a * wz,
        b * wx * wz + a * wy,
    )
    out[1, 0], out[1, 1], out[1, 2] = (
        b * wx * wy + a * wz,
        1.0 - b * (wx * wx + wz * wz),
        b * wy * wz - a * wx,
    )
    out[2, 0], out[2, 1], out[2, 2] = (
        b * wx * wz - a * wy,
        b * wy * wz + a * wx,
        1.0 - b * (wx * wx + wy * wy),
    )


@helper
def cosine_sine(angle):
    """(cos, sin) of an angle, rad; of a small one by series, exact to double precision."""
    square = angle * angle
    if all_lanes(square < 1e-4):
        c = 1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0))
        return c, angle * (
            1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
        )
    return cos(angle), sin(angle)


@helper
def solve(H, g):
    """Solve H x = -g in place by LDL^T (x replaces g); False when a pivot is not positive."""
    definite = True
    n = g.size
    for k in range(n):
        definite = definite and H[k, k] > 0.0
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


@helper
def row(a, i):
    """Row i of an array (n, 3) as three numbers."""
    return a[i, 0], a[i, 1], a[i, 2]


@helper
def put(a, i, v):
    """Write three numbers into row i of an array (n, 3)."""
    a[i, 0], a[i, 1], a[i, 2] = v[0], v[1], v[2]


@helper
def dot(a, b):
    """Scalar product of three numbers each."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@helper
def cross(a, b):
    """Vector product of three numbers each."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@helper
def plus(a, share, b):
    """a + share b, of three numbers each."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]
