"""Riccati interior-point method as a solver: checks the problem's form and reads its arrays."""

from __future__ import annotations

from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from slot_core.config import ConfigError
from slot_core.mpc.interior_point import minimise
from slot_core.mpc.model import FEET, INPUTS, STATES, HorizonQp
from slot_core.mpc.riccati import HALF, SIDES, Factor, Iterate, QuadraticProgram
from slot_core.mpc.solver import MpcSolverSettings, Solution
from slot_core.robot import Array

STAGE = INPUTS + STATES
FRICTION_ROWS = 4 * FEET
ROUNDOFF = 1e-9  # largest error of the dynamics, relative to the largest variable


class Blocks(NamedTuple):
    """Indices of the stages' numbers among the entries of A and G; -1 for a zero."""

    step: NDArray[np.intp]  # (6, 6) of a[:6, 6:]; empty with a single stage
    gain: NDArray[np.intp]  # (12, 6) of b[6:]'
    friction: NDArray[np.intp]  # (H, 4) of -mu


class RiccatiSolver:
    """Solves the problem without options: 12 forces and 12 states per stage, friction and bounds.

    Every iterate keeps the limits of the forces. It starts cold: the solution depends only on the
    problem, neither on earlier ones nor on the processor.
    """

    def __init__(self, qp: HorizonQp, settings: MpcSolverSettings):
        """Set up; raises ConfigError for a problem with options."""
        _check(qp)
        self._qp, self._settings = qp, settings
        self._weight = qp.P.diagonal().reshape(qp.horizon, STAGE)
        self._blocks = _find_blocks(qp)
        self._iterate, self._factor = _iterate(qp.horizon), _factor(qp.horizon)

    def solve(self) -> Solution:
        """Solve the problem with its present values."""
        qp, limits, it = self._qp, self._settings, self._iterate
        count, solved = minimise(
            self._read(),
            it,
            self._factor,
            limits.tolerance_abs,
            limits.tolerance_rel,
            limits.iterations,
        )
        z = np.concatenate([it.u.reshape(-1, INPUTS), it.x], axis=1).ravel()
        error = float(np.abs(qp.A @ z - qp.b.ravel()).max())
        fault = "" if solved else f"not converged after {count} iterations"
        if (qp.upper < 0.0).any():
            fault = "infeasible: a force limit below zero"
        if solved and not error <= ROUNDOFF * max(1.0, float(np.abs(z).max())):
            fault = f"dynamics violated by {error:.1g}: not those of one double integrator"
        return Solution(z, fault, count)

    def _read(self) -> QuadraticProgram:
        """The arrays of the problem, stage by stage."""
        qp = self._qp
        a, g = np.append(qp.A.data, 0.0), qp.G.data
        gain = -a[self._blocks.gain]
        return QuadraticProgram(
            weight=self._weight,
            linear=qp.c.reshape(qp.horizon, STAGE),
            drift=qp.b.reshape(qp.horizon, STATES),
            step=-a[self._blocks.step] if qp.horizon > 1 else _step_of_one(qp, gain),
            gain=gain,
            friction=-g[self._blocks.friction],
            limit=np.ascontiguousarray(qp.upper[:, 2:INPUTS:3]),
        )


def _step_of_one(qp: HorizonQp, gain: Array) -> Array:
    """E from b[:6] = E b[6:] / 2, for a single stage, in which `a` does not occur."""
    forces = qp.A[:HALF, :INPUTS].toarray()
    step = np.linalg.lstsq(gain, -2.0 * forces.T, rcond=None)[0].T
    return np.ascontiguousarray(step)


def _check(qp: HorizonQp) -> None:
    """Raise ConfigError unless the problem is the one without options."""
    stages = qp.horizon
    if qp.P.shape[0] != stages * STAGE or sparse.triu(qp.P, k=1).nnz:
        _refuse("other variables than forces and states, or a cost between them")
    if qp.A.shape[0] != stages * STATES or qp.G.shape[0] != stages * FRICTION_ROWS:
        _refuse("model.support equality: a constraint on all legs")
    forces = qp.P.diagonal().reshape(stages, -1)[:, :INPUTS]
    if np.any(qp.h != 0.0) or np.any(qp.lower[:, 2:INPUTS:3] != 0.0) or np.any(forces <= 0.0):
        _refuse("limits other than friction, or forces without a weight")


def _refuse(form: str) -> NoReturn:
    raise ConfigError(f"mpc.yaml: solver.name = riccati does not cover {form}; use piqp")


def _find_blocks(qp: HorizonQp) -> Blocks:
    """Locate the blocks in the arrays of `qp`."""
    a, g = _entries(qp.A), _entries(qp.G)
    stages = np.arange(qp.horizon)[:, None]
    legs = np.arange(FEET)
    return Blocks(
        step=np.ascontiguousarray(a[STATES : STATES + HALF, STAGE - HALF : STAGE]),
        gain=np.ascontiguousarray(a[HALF:STATES, :INPUTS].T),
        friction=g[FRICTION_ROWS * stages + 4 * legs, STAGE * stages + 3 * legs + 2],
    )


def _entries(matrix: sparse.csc_matrix) -> NDArray[np.intp]:
    """Index (rows, columns) of each entry in `data`, -1 for none."""
    numbered = sparse.csc_matrix(
        (np.arange(1.0, matrix.nnz + 1), matrix.indices, matrix.indptr), shape=matrix.shape
    )
    return numbered.toarray().astype(np.intp) - 1


def _iterate(stages: int) -> Iterate:
    """An iterate of zeros."""
    forces, sides, states = (stages, FEET, 3), (stages, FEET, SIDES), (stages, STATES)
    hessian = (stages, HALF, HALF)
    point, steps = [forces, sides, sides], [forces, sides, sides, sides]
    return Iterate(*map(np.zeros, [*point, *steps, states, states, forces, forces, hessian]))


def _factor(stages: int) -> Factor:
    """A factorisation of zeros."""
    half, wide = (HALF, HALF), (HALF, STATES)
    shapes = [
        (3, *half),
        (stages, FEET, 5),
        (INPUTS, HALF),
        half,
        half,
        (stages, *half),
        (stages, *wide),
        (stages, *half),
        (stages, *wide),
        (stages, HALF),
        (stages, HALF),
        (4, STATES),
    ]
    return Factor(*map(np.zeros, shapes))
