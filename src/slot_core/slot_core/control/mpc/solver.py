"""The solvers of the convex MPC behind one interface: built on a `HorizonQp`, then `solve()`.

Each reads the arrays of the problem as they stand, updates its own copy of the data in place and
keeps what does not change. Only the chosen one is imported.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

from slot_core.config import choice, quantity
from slot_core.control.mpc.model import HorizonQp
from slot_core.robot import Array

SOLVERS = {
    "riccati": ("slot_core.control.mpc.riccati_solver", "RiccatiSolver"),
    "piqp": ("slot_core.control.mpc.piqp_solver", "PiqpSolver"),
    "clarabel": ("slot_core.control.mpc.clarabel_solver", "ClarabelSolver"),
    "osqp": ("slot_core.control.mpc.osqp_solver", "OsqpSolver"),
}


@dataclass(frozen=True)
class MpcSolverSettings:
    """Which solver, and when it ends."""

    name: str = choice("solver", *SOLVERS)
    backend: str = choice("PIQP's factorisation of the KKT system", "multistage", "ldlt")
    tolerance_abs: float = quantity("absolute residual and duality gap", "", 1e-12, 1e-1)
    tolerance_rel: float = quantity("relative residual and duality gap", "", 1e-12, 1e-1)
    iterations: int = quantity("limit of iterations; OSQP's are many and cheap", "", 1, 100000)


@dataclass(frozen=True)
class Solution:
    """What a solver returned."""

    z: Array
    fault: str  # empty if solved
    iterations: int
    residual_primal: float = 0.0  # as the solver reports it, in the units of the rows
    residual_dual: float = 0.0


class QpSolver(Protocol):
    """min 1/2 z'Pz + c'z with A z = b, G z <= h, lower <= z <= upper."""

    def __init__(self, qp: HorizonQp, settings: MpcSolverSettings):
        """Lay out everything that depends on the sparsity of `qp` only.

        Raises ConfigError where the solver does not cover a form of the problem.
        """

    def solve(self) -> Solution:
        """Solve `qp` as it stands; raises nothing, and ends within `settings.iterations`."""


def make_solver(qp: HorizonQp, settings: MpcSolverSettings) -> QpSolver:
    """The solver that `settings.name` asks for."""
    module, name = SOLVERS[settings.name]
    solver: QpSolver = getattr(import_module(module), name)(qp, settings)
    return solver
