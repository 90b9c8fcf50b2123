"""Convex programmes by Clarabel, an interior-point method (Goulart and Chen, 2024).

It starts cold and is plain Rust with one order of operations: every processor gives the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from slot_core.arrays import Array


@dataclass(frozen=True)
class Solution:
    """Result of the solver."""

    z: Array  # the variables
    fault: str  # one line, empty if solved
    iterations: int


def options(
    tolerance_abs: float, tolerance_rel: float, iterations: int
) -> clarabel.DefaultSettings:
    """Settings of Clarabel: residuals and duality gap of a solution, most iterations."""
    made = clarabel.DefaultSettings()
    made.verbose = False
    made.max_threads = 1
    made.direct_solve_method = "qdldl"
    # Entries removed by presolving could not be updated.
    made.presolve_enable = False
    made.input_sparse_dropzeros = False
    made.tol_gap_abs, made.tol_gap_rel = tolerance_abs, tolerance_rel
    made.tol_feas = tolerance_rel
    made.max_iter = iterations
    return made


def solution_of(solver: clarabel.DefaultSolver) -> Solution:
    """Solve; raises nothing."""
    found = solver.solve()
    count = int(found.iterations)
    solved = found.status == clarabel.SolverStatus.Solved
    fault = "" if solved else f"{found.status} after {count} iterations"
    return Solution(np.array(found.x), fault, count)


def solve_within(  # noqa: PLR0917 - as written in mathematics
    hessian: Array,
    gradient: Array,
    rows: Array,
    low: Array,
    high: Array,
    settings: clarabel.DefaultSettings,
) -> Solution:
    """Minimum z (n,) of z'Hz / 2 + g'z with low <= rows z <= high (m,); H positive definite."""
    cones = [clarabel.NonnegativeConeT(2 * len(rows))]
    limits = sparse.csc_matrix(np.vstack([rows, -rows]))
    parts = sparse.triu(hessian, format="csc"), gradient, limits, np.concatenate([high, -low])
    return solution_of(clarabel.DefaultSolver(*parts, cones, settings))
