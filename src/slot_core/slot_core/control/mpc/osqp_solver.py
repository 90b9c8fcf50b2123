"""OSQP, an operator splitting method (Stellato et al., 2020)."""

from __future__ import annotations

import numpy as np
import osqp
from scipy import sparse

from slot_core.control.mpc.constraint_rows import ConstraintRows
from slot_core.control.mpc.model import HorizonQp
from slot_core.control.mpc.solver import MpcSolverSettings, Solution
from slot_core.robot import Array


class OsqpSolver:
    """Rows l <= C z <= u; starts from its last solution, and afresh after a failure.

    Without polishing, which takes a third longer and gains nothing that a tolerance would not.
    """

    def __init__(self, qp: HorizonQp, settings: MpcSolverSettings):
        """Lay out the factorisation for the sparsity of `qp`."""
        self._qp, self._rows, self._settings = qp, ConstraintRows(qp), settings
        self._solver: osqp.OSQP | None = self._set_up(*self._sides())

    def _set_up(self, low: Array, high: Array) -> osqp.OSQP:
        solver = osqp.OSQP()
        self._rows.refresh()
        solver.setup(
            P=sparse.triu(self._qp.P, format="csc"),
            q=self._qp.c,
            A=self._rows.matrix,
            l=low,
            u=high,
            eps_abs=self._settings.tolerance_abs,
            eps_rel=self._settings.tolerance_rel,
            max_iter=self._settings.iterations,
            polishing=False,
            verbose=False,
        )
        return solver

    def solve(self) -> Solution:
        """Solve the problem as it stands."""
        low, high = self._sides()
        if not np.all(low <= high):  # OSQP would print a line and solve the problem before
            return Solution(np.full(len(self._qp.c), np.nan), "limits exclude each other", 0)
        if self._solver is None:  # step sizes adapted to what failed would stay
            self._solver = self._set_up(low, high)
        self._solver.update(q=self._qp.c, l=low, u=high, Ax=self._rows.refresh())
        found = self._solver.solve(raise_error=False)
        count = int(found.info.iter)
        fault = ""
        if found.info.status_val != osqp.SolverStatus.OSQP_SOLVED:
            fault = f"{found.info.status} after {count} iterations"
            self._solver = None
        residuals = float(found.info.prim_res), float(found.info.dual_res)
        return Solution(np.array(found.x), fault, count, *residuals)

    def _sides(self) -> tuple[Array, Array]:
        qp = self._qp
        (bounded,) = self._rows.bounded
        none = np.full(len(qp.h), -np.inf)
        equal = qp.b.ravel()
        low = np.concatenate([equal, none, qp.lower.ravel()[bounded]])
        return low, np.concatenate([equal, qp.h, qp.upper.ravel()[bounded]])
