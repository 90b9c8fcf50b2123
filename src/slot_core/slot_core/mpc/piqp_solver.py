"""PIQP: a proximal interior-point method (Schwan et al., CDC 2023)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import piqp

from slot_core.mpc.model import HorizonQp
from slot_core.mpc.solver import MpcSolverSettings, Solution
from slot_core.robot import Array


class PiqpSolver:
    """Starts cold, since PIQP has no warm start.

    Its roundoff depends on the processor: the library loads one of several compiled variants.
    """

    STATE = None  # of no key frame: its work space, which cannot be read, changes the last bits

    def __init__(self, qp: HorizonQp, settings: MpcSolverSettings):
        """Set up the factorisation for the sparsity of `qp`."""
        self._qp, self._settings = qp, settings
        self._set_up()

    def _set_up(self) -> None:
        qp, settings = self._qp, self._settings
        self._solver = piqp.SparseSolver()
        options = self._solver.settings
        options.kkt_solver = getattr(piqp.KKTSolver, f"sparse_{settings.backend}")
        options.eps_abs = options.eps_duality_gap_abs = settings.tolerance_abs
        options.eps_rel = options.eps_duality_gap_rel = settings.tolerance_rel
        options.max_iter = settings.iterations
        # PIQP 0.6.4 rescales on update, but an unchanged P keeps its old scale: it then solves
        # another problem and reports success. So the scale of the set-up is kept for all updates.
        options.preconditioner_reuse_on_update = True
        self._solver.setup(P=qp.P, A=qp.A, G=qp.G, x_l=qp.lower.ravel(), **self._vectors())

    def solve(self) -> Solution:
        """Solve the problem with its present values."""
        self._solver.update(A=self._qp.A, G=self._qp.G, **self._vectors())
        return solution(self._solver, self._set_up)

    def _vectors(self) -> dict[str, Array]:
        """The vectors that change from tick to tick."""
        qp = self._qp
        return {"c": qp.c, "b": qp.b.ravel(), "h_u": qp.h, "x_u": qp.upper.ravel()}


def solution(solver: piqp.DenseSolver | piqp.SparseSolver, set_up: Callable[[], None]) -> Solution:
    """Solve; set the solver up anew where it fails, else a NaN stays in its work space."""
    status = solver.solve()
    z, count = np.array(solver.result.x), int(solver.result.info.iter)
    if status == piqp.PIQP_SOLVED:
        return Solution(z, "", count)
    set_up()
    return Solution(z, f"{status.name} after {count} iterations", count)
