"""Kernels of quaternions and small matrices, for the error-state filter.

Quaternions are x y z w.
"""

# mypy: disable-error-code="no-untyped-def"

import math

from slot_core.compiled import helper
from slot_core.elementary import atan2, cos, sin
from slot_core.matrices import set_product

SMALL_ANGLE = (
    1e-4  # rad, below which the next term of a series is less than a rounding error
)


@helper
def exponential(x, y, z):
    """Unit quaternion (x y z w) of the rotation vector (x, y, z), rad."""
    angle = math.sqrt(x * x + y * y + z * z)
    small = angle < SMALL_ANGLE
    scale = 0.5 - angle * angle / 48.0 if small else sin(angle / 2.0) / angle
    return x * scale, y * scale, z * scale, cos(angle / 2.0)


@helper
def logarithm(x, y, z, w):
    """Rotation vector, rad, of at most pi, of the unit quaternion (x y z w)."""
    sine = math.sqrt(x * x + y * y + z * z)
    sign = 1.0 if w >= 0.0 else -1.0  # -q is the same rotation
    if sine < SMALL_ANGLE:
        scale = sign * (2.0 + sine * sine / 3.0)
    else:
        scale = sign * 2.0 * atan2(sine, abs(w)) / sine
    return x * scale, y * scale, z * scale


@helper
def multiply(a, b):
    """Product a b of two quaternions: first the rotation b, then a."""
    ax, ay, az, aw = a[0], a[1], a[2], a[3]
    bx, by, bz, bw = b[0], b[1], b[2], b[3]
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


@helper
def store_unit(out, q):
    """Store the quaternion q in out (4,), of unit norm."""
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        out[i] = q[i] / norm


@helper
def rotation_matrix(out, q):
    """Rotation matrix (3, 3) of the unit quaternion q."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    out[0, 0], out[0, 1], out[0, 2] = (
        1 - 2 * (y * y + z * z),
        2 * (x * y - z * w),
        2 * (x * z + y * w),
    )
    out[1, 0], out[1, 1], out[1, 2] = (
        2 * (x * y + z * w),
        1 - 2 * (x * x + z * z),
        2 * (y * z - x * w),
    )
    out[2, 0], out[2, 1], out[2, 2] = (
        2 * (x * z - y * w),
        2 * (y * z + x * w),
        1 - 2 * (x * x + y * y),
    )


@helper
def rotate(m, a):
    """The rotation matrix m (3, 3) times the vector a (3,)."""
    return (
        m[0, 0] * a[0] + m[0, 1] * a[1] + m[0, 2] * a[2],
        m[1, 0] * a[0] + m[1, 1] * a[1] + m[1, 2] * a[2],
        m[2, 0] * a[0] + m[2, 1] * a[1] + m[2, 2] * a[2],
    )


@helper
def set_cross(out, row, column, a, scale):
    """Set a block (3, 3) of out to scale [a]x, with [a]x b = a x b."""
    x, y, z = scale * a[0], scale * a[1], scale * a[2]
    out[row, column], out[row, column + 1], out[row, column + 2] = 0.0, -z, y
    out[row + 1, column], out[row + 1, column + 1], out[row + 1, column + 2] = (
        z,
        0.0,
        -x,
    )
    out[row + 2, column], out[row + 2, column + 1], out[row + 2, column + 2] = (
        -y,
        x,
        0.0,
    )


@helper
def set_scaled(out, row, column, m, scale):
    """Set a block (3, 3) of out to scale m."""
    for i in range(3):
        for j in range(3):
            out[row + i, column + j] = scale * m[i, j]


@helper
def set_identity(out):
    """Set out (m, n) to ones on the diagonal and zeros beside it."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = 1.0 if i == j else 0.0


@helper
def congruence(p, f, half):
    """p <- f p f^T with a symmetric p; fast where f is sparse. half: work space of p's shape."""
    set_product(half, f, p)
    for i in range(p.shape[0]):
        for j in range(i):
            half[i, j], half[j, i] = half[j, i], half[i, j]
    set_product(p, f, half)


@helper
def symmetrise(a):
    """a <- (a + a^T) / 2."""
    for i in range(a.shape[0]):
        for j in range(i):
            a[i, j] = a[j, i] = 0.5 * (a[i, j] + a[j, i])
