"""Quadratic form of a part of a spatial leg, and the 4 x 4 pivot of a segment."""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from typing import NamedTuple

from slot_core.compiled import helper
from slot_core.dynamics.spatial.hinge import Symmetric


class Form(NamedTuple):
    """Quadratic form over (X, Phi, lambda | 1) of the leg beyond a node."""

    place: Symmetric  # over X
    x: tuple[float, float, float]  # rows X of the coupling to Phi
    y: tuple[float, float, float]
    z: tuple[float, float, float]
    turn: Symmetric  # over Phi
    pull: tuple[float, float, float]  # column of lambda, rows X
    twist: tuple[float, float, float]  # rows Phi
    force: tuple[float, float, float]  # gradient, rows X
    moment: tuple[float, float, float]  # rows Phi


class Pivot(NamedTuple):
    """Factors L D L^T of a symmetric 4 x 4 matrix: L below the diagonal, 1 / D."""

    l10: float
    l20: float
    l30: float
    l21: float
    l31: float
    l32: float
    d0: float
    d1: float
    d2: float
    d3: float
    positive: bool


@helper
def sum_of(a, b):
    """Sum of two symmetric matrices."""
    return Symmetric(
        a.xx + b.xx,
        a.xy + b.xy,
        a.xz + b.xz,
        a.yy + b.yy,
        a.yz + b.yz,
        a.zz + b.zz,
    )


@helper
def factor(xx, xy, xz, xw, yy, yz, yw, zz, zw, ww):
    """Factors of a symmetric 4 x 4 matrix, and whether it is positive definite."""
    d0 = 1.0 / xx
    l10 = xy * d0
    l20 = xz * d0
    l30 = xw * d0
    yy = yy - l10 * xy
    yz = yz - l10 * xz
    yw = yw - l10 * xw
    d1 = 1.0 / yy
    l21 = yz * d1
    l31 = yw * d1
    zz = zz - l20 * xz - l21 * yz
    zw = zw - l20 * xw - l21 * yw
    d2 = 1.0 / zz
    l32 = zw * d2
    ww = ww - l30 * xw - l31 * yw - l32 * zw
    positive = (xx > 0.0) & (yy > 0.0) & (zz > 0.0) & (ww > 0.0)
    return Pivot(l10, l20, l30, l21, l31, l32, d0, d1, d2, 1.0 / ww, positive)


@helper
def solve(p, r):
    """Solution of the pivot's system for a right-hand side of four numbers."""
    b = r[1] - p.l10 * r[0]
    c = r[2] - p.l20 * r[0] - p.l21 * b
    d = r[3] - p.l30 * r[0] - p.l31 * b - p.l32 * c
    d = d * p.d3
    c = c * p.d2 - p.l32 * d
    b = b * p.d1 - p.l21 * c - p.l31 * d
    return r[0] * p.d0 - p.l10 * b - p.l20 * c - p.l30 * d, b, c, d


@helper
def solve_rows(p, rows):
    """Solutions for the three right-hand sides of a block."""
    return solve(p, rows[0]), solve(p, rows[1]), solve(p, rows[2])


@helper
def dot4(a, b):
    """Product of two rows of four numbers."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@helper
def dots(rows, b):
    """Products of three rows with a fourth, of four numbers each."""
    return dot4(rows[0], b), dot4(rows[1], b), dot4(rows[2], b)


@helper
def less(a, left, right):
    """a - left right^T, symmetric, for blocks of three rows of four numbers."""
    return Symmetric(
        xx=a.xx - dot4(left[0], right[0]),
        xy=a.xy - dot4(left[0], right[1]),
        xz=a.xz - dot4(left[0], right[2]),
        yy=a.yy - dot4(left[1], right[1]),
        yz=a.yz - dot4(left[1], right[2]),
        zz=a.zz - dot4(left[2], right[2]),
    )
