"""OSQP: an operator splitting method (Stellato et al., 2020)."""

from __future__ import annotations

import numpy as np
import osqp
from scipy import sparse

from slot_core.control.mpc.constraint_rows import ConstraintRows
from slot_core.control.mpc.model import HorizonQp
from slot_core.control.mpc.solver import MpcSolverSettings, Solution
from slot_core.robot import Array


class OsqpSolver:
    """Constraints l <= C z <= u; starts from its last solution, after a failure from zero.

    Polishing is off: it takes a third longer and gains no more than a smaller tolerance does.
    """

    def __init__(self, qp: HorizonQp, settings: MpcSolverSettings):
        """Set up the factorisation for the sparsity of `qp`."""
        self._qp, self._rows, self._settings = qp, ConstraintRows(qp), settings
        self._solver: osqp.OSQP | None = self._set_up(*self._limits())

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
        """Solve the problem with its present values."""
        low, high = self._limits()
        if not np.all(low <= high):  # OSQP would print a line and solve the previous problem
            return Solution(
                np.full(len(self._qp.c), np.nan), "infeasible: lower limit above upper limit", 0
            )
        if self._solver is None:  # else the step sizes adapted in the failed solve stay
            self._solver = self._set_up(low, high)
        self._solver.update(q=self._qp.c, l=low, u=high, Ax=self._rows.refresh())
        found = self._solver.solve(raise_error=False)
        count = int(found.info.iter)
        fault = ""
        if found.info.status_val != osqp.SolverStatus.OSQP_SOLVED:
            fault = f"{found.info.status} after {count} iterations"
            self._solver = None
        return Solution(np.array(found.x), fault, count)

    def _limits(self) -> tuple[Array, Array]:
        """The vectors l and u."""
        qp = self._qp
        (bounded,) = self._rows.bounded
        none = np.full(len(qp.h), -np.inf)
        equal = qp.b.ravel()
        low = np.concatenate([equal, none, qp.lower.ravel()[bounded]])
        return low, np.concatenate([equal, qp.h, qp.upper.ravel()[bounded]])
