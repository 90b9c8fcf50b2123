"""PIQP, a proximal interior-point method (Schwan et al., CDC 2023)."""

from __future__ import annotations

import numpy as np
import piqp

from slot_core.control.mpc.model import HorizonQp
from slot_core.control.mpc.solver import MpcSolverSettings, Solution
from slot_core.robot import Array


class PiqpSolver:
    """An interior-point method starts cold; PIQP offers no warm start.

    Its arithmetic depends on the processor: it comes compiled for several, one of which is loaded.
    """

    def __init__(self, qp: HorizonQp, settings: MpcSolverSettings):
        """Lay out the factorisation for the sparsity of `qp`."""
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
        # PIQP 0.6.4 rescales on update but leaves an unchanged P in its old scale: it then reports
        # the optimum of another problem as solved. The scale of the set-up serves all updates.
        options.preconditioner_reuse_on_update = True
        self._solver.setup(P=qp.P, A=qp.A, G=qp.G, x_l=qp.lower.ravel(), **self._changing())

    def solve(self) -> Solution:
        """Solve the problem as it stands."""
        self._solver.update(A=self._qp.A, G=self._qp.G, **self._changing())
        status = self._solver.solve()
        info = self._solver.result.info
        count = int(info.iter)
        z, residuals = np.array(self._solver.result.x), (info.primal_res, info.dual_res)
        fault = ""
        if status != piqp.PIQP_SOLVED:
            fault = f"{status.name} after {count} iterations"
            self._set_up()  # a NaN in its work space would stay, and fail every solve to come
        return Solution(z, fault, count, *map(float, residuals))

    def _changing(self) -> dict[str, Array]:
        qp = self._qp
        return {"c": qp.c, "b": qp.b.ravel(), "h_u": qp.h, "x_u": qp.upper.ravel()}
