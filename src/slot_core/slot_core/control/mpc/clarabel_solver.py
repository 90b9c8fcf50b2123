"""Clarabel, an interior-point method for conic programmes (Goulart and Chen, 2024)."""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import sparse

from slot_core.control.mpc.constraint_rows import ConstraintRows
from slot_core.control.mpc.model import HorizonQp
from slot_core.control.mpc.solver import MpcSolverSettings, Solution
from slot_core.robot import Array


class ClarabelSolver:
    """Rows C z + s = d, s zero for equalities and else not negative; it starts cold."""

    def __init__(self, qp: HorizonQp, settings: MpcSolverSettings):
        """Lay out the factorisation for the sparsity of `qp`."""
        self._qp, self._rows = qp, ConstraintRows(qp, signs=(-1, 1))
        equalities = qp.A.shape[0]
        inequalities = self._rows.matrix.shape[0] - equalities
        cones = [clarabel.ZeroConeT(equalities), clarabel.NonnegativeConeT(inequalities)]
        self._solver = clarabel.DefaultSolver(
            sparse.triu(qp.P, format="csc"),
            qp.c,
            self._rows.matrix,
            self._right(),
            cones,
            _options(settings),
        )

    def solve(self) -> Solution:
        """Solve the problem as it stands."""
        self._solver.update(q=self._qp.c, A=self._rows.refresh(), b=self._right())
        found = self._solver.solve()
        count = int(found.iterations)
        solved = found.status == clarabel.SolverStatus.Solved
        fault = "" if solved else f"{found.status} after {count} iterations"
        return Solution(np.array(found.x), fault, count, float(found.r_prim), float(found.r_dual))

    def _right(self) -> Array:
        qp = self._qp
        below, above = self._rows.bounded
        bounds = [-qp.lower.ravel()[below], qp.upper.ravel()[above]]
        return np.concatenate([qp.b.ravel(), qp.h, *bounds])


def _options(settings: MpcSolverSettings) -> clarabel.DefaultSettings:
    options = clarabel.DefaultSettings()
    options.verbose = False
    options.max_threads = 1
    # What presolving leaves out cannot be updated.
    options.presolve_enable = False
    options.input_sparse_dropzeros = False
    options.tol_gap_abs, options.tol_gap_rel = settings.tolerance_abs, settings.tolerance_rel
    options.tol_feas = settings.tolerance_rel
    options.max_iter = settings.iterations
    return options
