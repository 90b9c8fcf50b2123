"""OSQP, an operator splitting method (Stellato et al., 2020)."""

from __future__ import annotations

import numpy as np
import osqp
from scipy import sparse

from slot_core.control.constraint_rows import ConstraintRows
from slot_core.control.mpc_model import HorizonQp
from slot_core.control.mpc_solver import Solution, SolverSettings
from slot_core.robot import Array


class OsqpSolver:
    """Rows l <= C z <= u; starts from its last solution, and from zero after a failure.

    Without polishing.
    """

    def __init__(self, qp: HorizonQp, settings: SolverSettings):
        """Lay out the factorisation for the sparsity of `qp`."""
        self._qp, self._rows = qp, ConstraintRows(qp)
        self._solver = osqp.OSQP()
        low, high = self._sides()
        self._solver.setup(
            P=sparse.triu(qp.P, format="csc"),
            q=qp.c,
            A=self._rows.matrix,
            l=low,
            u=high,
            eps_abs=settings.tolerance_abs,
            eps_rel=settings.tolerance_rel,
            max_iter=settings.iterations,
            polishing=False,
            verbose=False,
        )

    def solve(self) -> Solution:
        """Solve the problem as it stands."""
        low, high = self._sides()
        self._solver.update(q=self._qp.c, l=low, u=high, Ax=self._rows.refresh())
        found = self._solver.solve(raise_error=False)
        count = int(found.info.iter)
        solved = found.info.status_val == osqp.SolverStatus.OSQP_SOLVED
        if not solved:
            rows, variables = self._rows.matrix.shape
            self._solver.warm_start(x=np.zeros(variables), y=np.zeros(rows))
        fault = "" if solved else f"{found.info.status} after {count} iterations"
        residuals = float(found.info.prim_res), float(found.info.dual_res)
        return Solution(np.array(found.x), fault, count, *residuals)

    def _sides(self) -> tuple[Array, Array]:
        qp = self._qp
        (bounded,) = self._rows.bounded
        none = np.full(len(qp.h), -np.inf)
        equal = qp.b.ravel()
        low = np.concatenate([equal, none, qp.lower.ravel()[bounded]])
        return low, np.concatenate([equal, qp.h, qp.upper.ravel()[bounded]])
