"""Dual active-set method for a small strictly convex quadratic programme.

    min  x' H x / 2 + g' x    subject to    low <= A x <= high

It starts from the minimum without limits, -H^-1 g, and adds the limit that is violated most. On the
way to it the multipliers of the limits in force change too; one whose multiplier would become
negative is dropped first (Goldfarb and Idnani, Mathematical Programming 27, 1983). With a plan's
few limits in force it takes some ten microseconds, where an interior-point method takes hundreds.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math

import numpy as np

from slot_core.arrays import Array, Shapes, checked, named, zeros
from slot_core.compiled import helper, kernel
from slot_core.matrices import cholesky, inner, solve_cholesky

PARALLEL = 1e-11  # share of a normal outside of those in force, below which it depends on them
STEPS_MAX = 400  # changes of the set of limits in force


def work_shapes(n: int) -> Shapes:
    """Arrays of `_minimise` for n variables."""
    return {
        "normal": (
            n,
            n,
        ),  # rows: normals of the limits in force, pointing inward
        "image": (n, n),  # rows: H^-1 normal
        "factor": (n, n),  # Cholesky factor of normal image^T
        "multiplier": (n,),
        "change": (n,),  # of the multipliers per length of a step
        "goal": (n,),  # normal of the limit to be added
        "way": (n,),  # H^-1 goal, then its part along the limits in force
    }


Workspace = named("Workspace", work_shapes(1), __name__)


class ActiveSet:
    """Solver for n variables."""

    def __init__(self, n: int):
        self._work = Workspace(**zeros(work_shapes(n)))

    def solve(
        self,
        inverse: Array,
        gradient: Array,
        rows: Array,
        low: Array,
        high: Array,
        slack: float,
    ) -> Array | None:
        """Minimum (n,), which violates a limit by `slack` at most; None if there is none.

        inverse: H^-1 (n, n); gradient: g (n,); rows: A (m, n); low, high (m,). Raises ValueError
        for other shapes.
        """
        n = len(self._work.goal)
        rows = checked("rows", rows, (-1, n))
        x = np.empty(n)
        is_found = _minimise(
            self._work,
            checked("inverse", inverse, (n, n), finite=False),
            -checked("gradient", gradient, (n,), finite=False),
            rows,
            checked("low", low, (len(rows),), finite=False),
            checked("high", high, (len(rows),), finite=False),
            slack,
            x,
        )
        return x if is_found else None


@kernel
def _minimise(work, inverse, slope, rows, low, high, slack, x):
    """Write the minimum into x (n,); whether it was found. slope: -g (n,)."""
    _image(inverse, slope, x)
    count = 0
    for _ in range(STEPS_MAX):
        row, side = _most_violated(rows, low, high, slack, x)
        if side == 0.0:
            return inner(x, x) < math.inf  # a number is not finite
        for i in range(x.size):
            work.goal[i] = side * rows[row, i]
        bound = low[row] if side > 0.0 else -high[row]
        count = _add(work, inverse, bound, count, x)
        if count < 0:
            return False
    return False


@helper
def _most_violated(rows, low, high, slack, x):
    """Row of the limit that is violated most, and its side: 1 low, -1 high, 0 none."""
    row, side, most = 0, 0.0, slack
    for k in range(rows.shape[0]):
        value = 0.0
        for i in range(x.size):
            value += rows[k, i] * x[i]
        if low[k] - value > most:
            row, side, most = k, 1.0, low[k] - value
        if value - high[k] > most:
            row, side, most = k, -1.0, value - high[k]
    return row, side


@helper
def _add(work, inverse, bound, count, x):
    """Move x to the limit goal' x >= bound and add it; the number of limits in force, or -1."""
    multiplier = 0.0
    for _ in range(STEPS_MAX):
        free, whole = _direction(work, inverse, count)
        first, dropped = math.inf, -1
        for k in range(count):
            if (
                work.change[k] > 0.0
                and work.multiplier[k] < first * work.change[k]
            ):
                first, dropped = work.multiplier[k] / work.change[k], k
        missing = bound - inner(work.goal, x)
        full = missing / free if free > PARALLEL * whole else math.inf
        step = min(first, full)
        if not step < math.inf:
            # no point is within the limits, or a number is not finite
            return -1
        if full < math.inf:
            for i in range(x.size):
                x[i] += step * work.way[i]
        for k in range(count):
            work.multiplier[k] -= step * work.change[k]
        multiplier += step
        if full <= first:
            if count == x.size:
                return -1
            for i in range(x.size):
                work.normal[count, i] = work.goal[i]
            _image(inverse, work.goal, work.image[count])
            work.multiplier[count] = multiplier
            return count + 1
        count -= 1
        for k in range(dropped, count):
            work.multiplier[k] = work.multiplier[k + 1]
            for i in range(x.size):
                work.normal[k, i], work.image[k, i] = (
                    work.normal[k + 1, i],
                    work.image[k + 1, i],
                )
    return -1


@helper
def _direction(work, inverse, count):
    """Write way and change towards the goal; goal' way, and goal' H^-1 goal."""
    _image(inverse, work.goal, work.way)
    whole = inner(work.goal, work.way)
    for k in range(count):
        work.change[k] = inner(work.normal[k], work.way)
        for j in range(k + 1):
            work.factor[k, j] = inner(work.normal[k], work.image[j])
    cholesky(work.factor[:count, :count])
    solve_cholesky(work.factor[:count, :count], work.change[:count])
    for k in range(count):
        for i in range(work.way.size):
            work.way[i] -= work.change[k] * work.image[k, i]
    return inner(work.goal, work.way), whole


@helper
def _image(inverse, vector, out):
    """out = inverse vector, of a symmetric inverse."""
    for i in range(out.size):
        out[i] = 0.0
    for k in range(out.size):
        for i in range(out.size):
            out[i] += inverse[k, i] * vector[k]
