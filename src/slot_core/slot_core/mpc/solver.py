"""Solver of the convex MPC: Clarabel, an interior-point method (Goulart and Chen, 2024).

It starts cold and is plain Rust with one order of operations: every processor gives the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from slot_core.arrays import Array
from slot_core.config import quantity
from slot_core.mpc.model import HorizonQp


@dataclass(frozen=True)
class MpcSolverSettings:
    """Termination criteria of the solver."""

    tolerance_abs: float = quantity(
        "largest absolute duality gap of a solution", "", 1e-12, 1e-1
    )
    tolerance_rel: float = quantity(
        "largest relative residual and duality gap of a solution", "", 1e-12, 1e-1
    )
    iterations: int = quantity(
        "largest number of iterations of the solver", "", 1, 100000
    )


@dataclass(frozen=True)
class Solution:
    """Result of the solver."""

    z: Array  # the variables
    fault: str  # one line, empty if solved
    iterations: int


def options(settings: MpcSolverSettings) -> clarabel.DefaultSettings:
    """Clarabel's settings."""
    made = clarabel.DefaultSettings()
    made.verbose = False
    made.max_threads = 1
    made.direct_solve_method = "qdldl"
    # Entries removed by presolving could not be updated.
    made.presolve_enable = False
    made.input_sparse_dropzeros = False
    made.tol_gap_abs, made.tol_gap_rel = settings.tolerance_abs, settings.tolerance_rel
    made.tol_feas = settings.tolerance_rel
    made.max_iter = settings.iterations
    return made


def solution_of(solver: clarabel.DefaultSolver) -> Solution:
    """Solve; raises nothing."""
    found = solver.solve()
    count = int(found.iterations)
    solved = found.status == clarabel.SolverStatus.Solved
    fault = "" if solved else f"{found.status} after {count} iterations"
    return Solution(np.array(found.x), fault, count)


class QpSolver:
    """Solver of a `HorizonQp`, without a memory of earlier solves.

    Constraints C z + s = d, with s = 0 for equalities and s >= 0 otherwise; C = [A; G; -1 or 1 for
    each bounded side of a variable]. The set of bounded variables is that at construction.
    """

    def __init__(self, qp: HorizonQp, settings: MpcSolverSettings):
        """Set up the factorisation for the sparsity of `qp`."""
        self._qp = qp
        sides = np.isfinite(qp.lower.ravel()), np.isfinite(qp.upper.ravel())
        self._below, self._above = (np.flatnonzero(side) for side in sides)
        unit = sparse.eye(qp.P.shape[0], format="csr")
        bounds = [-unit[self._below], unit[self._above]]
        self._matrix = sparse.vstack([qp.A, qp.G, *bounds], format="csc")
        self._slots = _slots(self._matrix, qp)
        equalities = qp.A.shape[0]
        inequalities = self._matrix.shape[0] - equalities
        cones = [
            clarabel.ZeroConeT(equalities),
            clarabel.NonnegativeConeT(inequalities),
        ]
        objective = sparse.triu(qp.P, format="csc"), qp.c
        parts = *objective, self._matrix, self._right_side(), cones, options(settings)
        self._solver = clarabel.DefaultSolver(*parts)

    def solve(self) -> Solution:
        """Solve `qp` with its present values; raises nothing."""
        a_entries, g_entries = self._slots
        self._matrix.data[a_entries] = self._qp.A.data
        self._matrix.data[g_entries] = self._qp.G.data
        self._solver.update(q=self._qp.c, A=self._matrix.data, b=self._right_side())
        return solution_of(self._solver)

    def _right_side(self) -> Array:
        """The vector d."""
        qp = self._qp
        bounds = [-qp.lower.ravel()[self._below], qp.upper.ravel()[self._above]]
        return np.concatenate([qp.b.ravel(), qp.h, *bounds])


def _slots(
    matrix: sparse.csc_matrix, qp: HorizonQp
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the entries of A and of G in `matrix.data`, in column order."""
    equalities, inequalities = qp.A.shape[0], qp.A.shape[0] + qp.G.shape[0]
    rows = matrix.indices
    a_entries = np.flatnonzero(rows < equalities)
    g_entries = np.flatnonzero((rows >= equalities) & (rows < inequalities))
    assert len(a_entries) == qp.A.nnz
    assert len(g_entries) == qp.G.nnz
    return a_entries, g_entries
