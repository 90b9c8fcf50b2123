"""Elementary functions with the same bits on every processor: sin, cos, atan2, exp and log.

The C library chooses its code for them by processor, with or without fused multiply-add, and NumPy
has vector code of its own for some. The functions of this module use nothing but +, -, *, / and
comparisons of float64, which IEEE 754 defines to the last bit. Their error is less than one unit in
the last place. `math.sqrt`, `math.floor` and `abs` are exact everywhere.

Each function takes numbers and arrays in Python, and numbers in kernels; `dynamics/lanes.py` adds
Lanes. `log` is for kernels; its `py_func` takes a number in Python. Reduction of the argument and
compensated sums: Muller, Elementary Functions (3rd edition, 2016), chapters 6 and 11.
"""

# mypy: disable-error-code="no-untyped-def"

import math
from fractions import Fraction
from typing import Any

import slot_core.compiled  # noqa: F401  # isort: skip
import numpy as np
from numba.core import types
from numba.extending import overload

from slot_core.arrays import Array
from slot_core.compiled import OPTIONS, helper, kernel

LARGEST = 1e6  # rad, above which sin and cos are NaN: the argument's own spacing is 1e-10 there
SHIFT = 1.5 * 2.0**52  # added and subtracted it rounds to the nearest integer
HALF_PI = Fraction(
    "1.5707963267948966192313216916397514420985846996875529104874722961539082031431"
)
LOG_2 = Fraction(
    "0.69314718055994530941723212145817656807550013436025525412068000949339362196969"
)
GRID = 32  # arc tangents of k / GRID are tabulated
# tangent below which the series of the arc tangent needs no table
SERIES_BELOW = 0.125
HALF_ROOT = 0.7071067811865476
COS, SIN, ATAN2 = range(3)
NUMBERS = (types.Float, types.Integer)


def _parts(value: Fraction, bits: int, count: int) -> tuple[float, ...]:
    """Numbers of `bits` bits each whose sum is the value; the last one has all of a float64's."""
    parts = []
    for _ in range(count - 1):
        unit = Fraction(2) ** (math.frexp(float(value))[1] - bits)
        parts.append(float(value // unit * unit))
        value -= Fraction(parts[-1])
    return *parts, float(value)


def _arc_tangents() -> Array:
    """(GRID + 1, 2) arc tangents of k / GRID as a float64 and its rounding error.

    atan(k / G) - atan((k - 1) / G) = atan(G / (G^2 + k (k - 1))), by Gregory's series.
    """
    one, total, rows = 1 << 160, 0, [(0.0, 0.0)]
    for k in range(1, GRID + 1):
        top, bottom = GRID, GRID * GRID + k * (k - 1)
        power, n = one * top // bottom, 0
        while power:
            total += (-1) ** n * power // (2 * n + 1)
            power = power * top * top // (bottom * bottom)
            n += 1
        exact = Fraction(total, one)
        rows.append((float(exact), float(exact - Fraction(float(exact)))))
    return np.array(rows)


P1, P2, P3, P4 = _parts(HALF_PI, 33, 4)
L1, L2 = _parts(LOG_2, 32, 2)
TWO_OVER_PI, PER_LOG_2 = float(1 / HALF_PI), float(1 / LOG_2)
QUARTER, QUARTER_REST = (
    float(HALF_PI),
    float(HALF_PI - Fraction(float(HALF_PI))),
)
ARC_TANGENT = _arc_tangents()


@helper
def _two_difference(a, b):
    """a - b as a float64 and its rounding error (Knuth)."""
    s = a - b
    t = s - a
    return s, (a - (s - t)) - (b + t)


@helper
def _reduced(x):
    """Multiple k of pi/2 nearest to x, and x - k pi/2 as a float64 and its rounding error."""
    k = (x * TWO_OVER_PI + SHIFT) - SHIFT
    s, first = _two_difference(x - k * P1, k * P2)
    s, second = _two_difference(s, k * P3)
    rest = first + second - k * P4
    y = s + rest
    return k, y, (s - y) + rest


@helper
def _sin_near_zero(y, rest):
    """sin(y + rest), |y| < pi/4, by Taylor's series; its next term is below 1e-19."""
    z = y * y
    p = 1.0 / 355687428096000.0
    p = -1.0 / 1307674368000.0 + z * p
    p = 1.0 / 6227020800.0 + z * p
    p = -1.0 / 39916800.0 + z * p
    p = 1.0 / 362880.0 + z * p
    p = -1.0 / 5040.0 + z * p
    p = 1.0 / 120.0 + z * p
    p = -1.0 / 6.0 + z * p
    return y + (z * y * p + rest * (1.0 - 0.5 * z))


@helper
def _cos_near_zero(y, rest):
    """cos(y + rest), |y| < pi/4, by Taylor's series; its next term is below 1e-18."""
    z = y * y
    q = 1.0 / 20922789888000.0
    q = -1.0 / 87178291200.0 + z * q
    q = 1.0 / 479001600.0 + z * q
    q = -1.0 / 3628800.0 + z * q
    q = 1.0 / 40320.0 + z * q
    q = -1.0 / 720.0 + z * q
    q = 1.0 / 24.0 + z * q
    half = 0.5 * z
    near = 1.0 - half
    return near + (((1.0 - near) - half) + (z * z * q - y * rest))


@helper
def _turned(x, quarters):
    """cos(x - quarters pi/2): the cosine for 0, the sine for 1."""
    if not abs(x) <= LARGEST:
        return math.nan
    k, y, rest = _reduced(x)
    quadrant = int(k - quarters) & 3
    if quadrant == 0:
        return _cos_near_zero(y, rest)
    if quadrant == 1:
        return -_sin_near_zero(y, rest)
    if quadrant == 2:
        return -_cos_near_zero(y, rest)
    return _sin_near_zero(y, rest)


@helper
def _halves(a):
    """A float64 as a sum of two of 26 bits (Veltkamp)."""
    t = 134217729.0 * a
    high = t - (t - a)
    return high, a - high


@helper
def _quotient(y, x):
    """y / x as a float64 and its rounding error, 0 <= y <= x (Dekker)."""
    q = y / x
    (a, b), (c, d) = _halves(q), _halves(x)
    p = q * x
    error = ((a * c - p) + a * d + b * c) + b * d
    return q, ((y - p) - error) / x


@helper
def _arc_of_ratio(y, x):
    """atan(y / x), 0 <= y <= x, as a float64 and its rounding error."""
    q, rest = _quotient(y, x)
    if q < SERIES_BELOW:
        k, t = 0, q
    else:
        k = int(q * GRID + 0.5)
        grid = k / GRID
        t = (q - grid) / (1.0 + q * grid)
        rest = rest / (1.0 + q * q)
    z = t * t
    p = 1.0 / 19.0
    for n in range(17, 1, -2):
        p = 1.0 / n - z * p
    rest += ARC_TANGENT[k, 1] - z * t * p
    high = ARC_TANGENT[k, 0] + t
    return high, (ARC_TANGENT[k, 0] - high) + t + rest


@helper
def _difference(whole, whole_rest, part, part_rest):
    """whole - part, each a float64 and its rounding error, 0 <= part <= whole."""
    s = whole - part
    return s, ((whole - s) - part) + (whole_rest - part_rest)


@helper
def _arc(y, x):
    """`atan2` of two numbers."""
    wide, high = abs(y), abs(x)
    steep = wide > high
    if steep:
        wide, high = high, wide
    if not high < math.inf:
        return math.nan
    if high == 0.0:
        high = 1.0
    elif not 1e-150 < high < 1e150:  # no overflow in a product
        scale = 2.0**600 if high < 1.0 else 2.0**-600
        wide, high = wide * scale, high * scale
    angle, rest = _arc_of_ratio(wide, high)
    if steep:
        angle, rest = _difference(QUARTER, QUARTER_REST, angle, rest)
    if math.copysign(1.0, x) < 0.0:
        angle, rest = _difference(
            2.0 * QUARTER, 2.0 * QUARTER_REST, angle, rest
        )
    return math.copysign(angle + rest, y)


@helper
def log(x):
    """Natural logarithm of a positive number that is normal, in a kernel.

    With f = m - 1 of the mantissa m and s = f / (2 + f), log(1 + f) = 2 artanh s.
    """
    mantissa, exponent = math.frexp(x)
    if mantissa < HALF_ROOT:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    f, k = mantissa - 1.0, float(exponent)
    s = f / (2.0 + f)
    z = s * s
    p = 2.0 / 23.0
    for n in range(21, 1, -2):
        p = 2.0 / n + z * p
    half = 0.5 * f * f
    return k * L1 + (f - (half - (s * (half + z * p) + k * L2)))


@kernel
def _each(function, y, x, out):
    """Write a function of each number of x (n,), or of y (n,) and x (n,), into out (n,)."""
    for i in range(out.size):
        if function == ATAN2:
            out[i] = _arc(y[i], x[i])
        else:
            out[i] = _turned(x[i], float(function))


def _applied(function: int, y: Any, x: Any) -> Any:
    """A function of numbers or arrays, which broadcast; a float for numbers."""
    y, x = np.asarray(y, dtype=float), np.asarray(x, dtype=float)
    if y.shape != x.shape:
        y, x = np.broadcast_arrays(y, x)
    out = np.empty(x.shape)
    _each(
        function,
        np.ascontiguousarray(y).ravel(),
        np.ascontiguousarray(x).ravel(),
        out.ravel(),
    )
    return out if out.ndim else float(out)


def cos(x: Any) -> Any:
    """Cosine of an angle, or an array of them, rad; NaN above `LARGEST`."""
    return _applied(COS, x, x)


def sin(x: Any) -> Any:
    """Sine of an angle, or an array of them, rad; NaN above `LARGEST`."""
    return _applied(SIN, x, x)


def atan2(y: Any, x: Any) -> Any:
    """Angle of the point (x, y), rad, in [-pi, pi], or of arrays of points; NaN if one is infinite.

    Its sign is that of y, also of a zero.
    """
    return _applied(ATAN2, y, x)


def hypot(x: Any, y: Any) -> Any:
    """Length sqrt(x^2 + y^2) of a vector, or of arrays of vectors; for lengths below 1e150."""
    return np.sqrt(x * x + y * y)


def exp(x: Any) -> Any:
    """e to the power of a number or an array; taken at +-700 beyond."""
    x = np.clip(x, -700.0, 700.0)
    k = (x * PER_LOG_2 + SHIFT) - SHIFT
    r, rest = _two_difference.py_func(x - k * L1, k * L2)  # type: ignore[attr-defined]
    p = np.ones_like(r)
    for n in range(15, 2, -1):
        p = 1.0 + r / n * p
    return np.ldexp(
        1.0 + (r + (rest + 0.5 * (r * r) * p)), np.asarray(k, dtype=int)
    )


@overload(cos, jit_options=OPTIONS)  # type: ignore[arg-type]
def _cos_in_kernels(x):
    return (lambda x: _turned(x, 0.0)) if isinstance(x, NUMBERS) else None


@overload(sin, jit_options=OPTIONS)  # type: ignore[arg-type]
def _sin_in_kernels(x):
    return (lambda x: _turned(x, 1.0)) if isinstance(x, NUMBERS) else None


@overload(atan2, jit_options=OPTIONS)  # type: ignore[arg-type]
def _atan2_in_kernels(y, x):
    is_number = isinstance(y, NUMBERS) and isinstance(x, NUMBERS)
    return (lambda y, x: _arc(y, x)) if is_number else None  # noqa: PLW0108 - no dispatcher
