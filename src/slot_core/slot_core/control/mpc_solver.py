"""The solver of the convex MPC: PIQP, called directly on the arrays of a `HorizonQp`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import piqp

from slot_core.config import choice, quantity
from slot_core.control.mpc_model import HorizonQp
from slot_core.robot import Array


@dataclass(frozen=True)
class SolverSettings:
    """PIQP: backend and termination."""

    backend: str = choice("factorisation of the KKT system", "multistage", "ldlt")
    tolerance_abs: float = quantity("absolute residual and duality gap", "", 1e-12, 1e-1)
    tolerance_rel: float = quantity("relative residual and duality gap", "", 1e-12, 1e-1)
    iterations: int = quantity("limit of iterations", "", 1, 1000)


@dataclass(frozen=True)
class Solution:
    """What a solver returned."""

    z: Array
    fault: str  # empty if solved
    iterations: int


class PiqpSolver:
    """PIQP, a proximal interior-point method (Schwan et al., CDC 2023), data updated in place.

    An interior-point method starts cold; PIQP offers no warm start.
    """

    def __init__(self, qp: HorizonQp, settings: SolverSettings):
        """Lay out the factorisation for the sparsity of `qp`."""
        self._qp = qp
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
        """Solve `qp` as it stands."""
        self._solver.update(A=self._qp.A, G=self._qp.G, **self._changing())
        status = self._solver.solve()
        result = self._solver.result
        count = int(result.info.iter)
        fault = "" if status == piqp.PIQP_SOLVED else f"{status.name} after {count} iterations"
        return Solution(np.array(result.x), fault, count)

    def _changing(self) -> dict[str, Array]:
        qp = self._qp
        return {"c": qp.c, "b": qp.b.ravel(), "h_u": qp.h, "x_u": qp.upper.ravel()}
