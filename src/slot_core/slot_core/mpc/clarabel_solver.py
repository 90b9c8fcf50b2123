"""Clarabel: an interior-point method for conic programmes (Goulart and Chen, 2024)."""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import sparse

from slot_core.key_frame import StateParts
from slot_core.mpc.constraint_rows import ConstraintRows
from slot_core.mpc.model import HorizonQp
from slot_core.mpc.solver import MpcSolverSettings, Solution
from slot_core.robot import Array


class ClarabelSolver:
    """Constraints C z + s = d, with s = 0 for equalities and s >= 0 otherwise; starts cold."""

    STATE = StateParts()

    def __init__(self, qp: HorizonQp, settings: MpcSolverSettings):
        """Set up the factorisation for the sparsity of `qp`."""
        self._qp, self._rows = qp, ConstraintRows(qp, signs=(-1, 1))
        equalities = qp.A.shape[0]
        inequalities = self._rows.matrix.shape[0] - equalities
        cones = [clarabel.ZeroConeT(equalities), clarabel.NonnegativeConeT(inequalities)]
        self._solver = clarabel.DefaultSolver(
            sparse.triu(qp.P, format="csc"),
            qp.c,
            self._rows.matrix,
            self._right_side(),
            cones,
            clarabel_options(settings),
        )

    def solve(self) -> Solution:
        """Solve the problem with its present values."""
        self._solver.update(q=self._qp.c, A=self._rows.refresh(), b=self._right_side())
        return solution_of(self._solver.solve())

    def _right_side(self) -> Array:
        """The vector d."""
        qp = self._qp
        below, above = self._rows.bounded
        bounds = [-qp.lower.ravel()[below], qp.upper.ravel()[above]]
        return np.concatenate([qp.b.ravel(), qp.h, *bounds])


def solution_of(found: clarabel.DefaultSolution) -> Solution:
    """The solution that Clarabel found."""
    count = int(found.iterations)
    solved = found.status == clarabel.SolverStatus.Solved
    fault = "" if solved else f"{found.status} after {count} iterations"
    return Solution(np.array(found.x), fault, count)


def clarabel_options(settings: MpcSolverSettings) -> clarabel.DefaultSettings:
    """Clarabel's settings."""
    options = clarabel.DefaultSettings()
    options.verbose = False
    options.max_threads = 1
    # Entries removed by presolving could not be updated.
    options.presolve_enable = False
    options.input_sparse_dropzeros = False
    options.tol_gap_abs, options.tol_gap_rel = settings.tolerance_abs, settings.tolerance_rel
    options.tol_feas = settings.tolerance_rel
    options.max_iter = settings.iterations
    return options
