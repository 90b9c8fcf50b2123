"""Interface of the convex MPC's solvers: built on a `HorizonQp`, then `solve()`.

Each solver reads the present arrays of the problem, updates its own copy of the data in place and
keeps what is constant. Only the chosen solver is imported.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

from slot_core.config import choice, quantity
from slot_core.mpc.model import HorizonQp
from slot_core.robot import Array

SOLVERS = {
    "piqp": ("slot_core.mpc.piqp_solver", "PiqpSolver"),
    "clarabel": ("slot_core.mpc.clarabel_solver", "ClarabelSolver"),
}


@dataclass(frozen=True)
class MpcSolverSettings:
    """Choice of the solver and its termination criteria."""

    name: str = choice("solver of the problem on forces", *SOLVERS)
    backend: str = choice("PIQP's factorisation of the KKT system", "multistage", "ldlt")
    tolerance_abs: float = quantity(
        "largest absolute residual and duality gap of a solution", "", 1e-12, 1e-1
    )
    tolerance_rel: float = quantity(
        "largest relative residual and duality gap of a solution", "", 1e-12, 1e-1
    )
    iterations: int = quantity("largest number of iterations of the solver", "", 1, 100000)


@dataclass(frozen=True)
class Solution:
    """Result of a solver."""

    z: Array  # the variables of `HorizonQp`
    fault: str  # one line, empty if solved
    iterations: int


class QpSolver(Protocol):
    """Solver of min 1/2 z'Pz + c'z with A z = b, G z <= h, lower <= z <= upper."""

    def __init__(self, qp: HorizonQp, settings: MpcSolverSettings):
        """Set up what depends only on the sparsity of `qp`.

        Raises ConfigError if the solver does not cover this form of the problem.
        """

    def solve(self) -> Solution:
        """Solve `qp` with its present values within `settings.iterations`; raises nothing."""


def make_solver(qp: HorizonQp, settings: MpcSolverSettings) -> QpSolver:
    """The solver named by `settings.name`; raises ConfigError as its constructor does."""
    module, name = SOLVERS[settings.name]
    solver: QpSolver = getattr(import_module(module), name)(qp, settings)
    return solver
