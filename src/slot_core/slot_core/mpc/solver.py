"""Solver of the convex MPC: Clarabel, an interior-point method (Goulart and Chen, 2024).

It starts cold and is plain Rust with one order of operations: every processor gives the same bits.
"""

from dataclasses import dataclass

import clarabel
import numpy as np

from slot_core.arrays import Array
from slot_core.config import quantity


@dataclass(frozen=True)
class MpcSolverSettings:
    """Termination criteria of the solver."""

    tolerance_abs: float = quantity(
        "largest absolute duality gap of a solution", "", 1e-12, 1e-1
    )
    tolerance_rel: float = quantity(
        "largest relative residual and duality gap of a solution",
        "",
        1e-12,
        1e-1,
    )
    iterations: int = quantity(
        "largest number of iterations of the solver", "", 1, 100000
    )


@dataclass(frozen=True)
class Solution:
    """Result of the solver."""

    z: Array  # the variables
    fault: str  # one line, empty if solved
    iterations: int


def options(settings: MpcSolverSettings) -> clarabel.DefaultSettings:
    """Clarabel's settings."""
    made = clarabel.DefaultSettings()
    made.verbose = False
    made.max_threads = 1
    made.direct_solve_method = "qdldl"
    # Entries removed by presolving could not be updated.
    made.presolve_enable = False
    made.input_sparse_dropzeros = False
    made.tol_gap_abs, made.tol_gap_rel = (
        settings.tolerance_abs,
        settings.tolerance_rel,
    )
    made.tol_feas = settings.tolerance_rel
    made.max_iter = settings.iterations
    return made


def solution_of(solver: clarabel.DefaultSolver) -> Solution:
    """Solve; raises nothing."""
    found = solver.solve()
    count, fault = int(found.iterations), ""
    if found.status != clarabel.SolverStatus.Solved:
        fault = f"{found.status} after {count} iterations"
    return Solution(np.array(found.x), fault, count)
