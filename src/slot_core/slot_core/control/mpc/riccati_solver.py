"""The Riccati interior-point method as a solver: checks the problem's form, reads its arrays."""

from __future__ import annotations

from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from slot_core.config import ConfigError
from slot_core.control.mpc.interior_point import minimise
from slot_core.control.mpc.model import HorizonQp
from slot_core.control.mpc.riccati import (
    FEET,
    HALF,
    INPUTS,
    SIDES,
    STATES,
    Factor,
    Iterate,
    QuadraticProgram,
)
from slot_core.control.mpc.solver import MpcSolverSettings, Solution
from slot_core.robot import Array

STAGE = INPUTS + STATES
FRICTION_ROWS = 4 * FEET
ROUNDOFF = 1e-9  # of the dynamics, over the largest state


class Blocks(NamedTuple):
    """Where the numbers of the stages stand among the entries of A and G; -1 for a zero."""

    step: NDArray[np.intp]  # (6, 6) of a[:6, 6:]; none with a single stage
    gain: NDArray[np.intp]  # (12, 6) of b[6:]'
    friction: NDArray[np.intp]  # (H, 4) of -mu


class RiccatiSolver:
    """Solves the problem without options: 12 forces and 12 states a stage, friction and bounds.

    Its forces keep their limits in every iteration. It starts cold: the answer depends on the
    problem alone, and not on the processor.
    """

    def __init__(self, qp: HorizonQp, settings: MpcSolverSettings):
        """Raises ConfigError for a form that it does not cover."""
        _check(qp)
        self._qp, self._settings = qp, settings
        self._weight = qp.P.diagonal().reshape(qp.horizon, STAGE)
        self._blocks = _find_blocks(qp)
        self._iterate, self._factor = _iterate(qp.horizon), _factor(qp.horizon)

    def solve(self) -> Solution:
        """Solve the problem as it stands."""
        qp, limits, it = self._qp, self._settings, self._iterate
        count, solved, slope = minimise(
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
            fault = f"dynamics missed by {error:.1g}: not those of one double integrator"
        return Solution(z, fault, count, error, slope)

    def _read(self) -> QuadraticProgram:
        """The arrays of the problem by stages."""
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
    """E from b[:6] = E b[6:] / 2, where no stage follows that would show it."""
    forces = qp.A[:HALF, :INPUTS].toarray()
    step = np.linalg.lstsq(gain, -2.0 * forces.T, rcond=None)[0].T
    return np.ascontiguousarray(step)


def _check(qp: HorizonQp) -> None:
    """Raise ConfigError unless this is the problem without options."""
    stages = qp.horizon
    if qp.P.shape[0] != stages * STAGE:
        _refuse("model.lag or model.least_weight: more than 24 variables a stage")
    if sparse.triu(qp.P, k=1).nnz:
        _refuse("model.support soft: a cost between the forces")
    if qp.A.shape[0] != stages * STATES or qp.G.shape[0] != stages * FRICTION_ROWS:
        _refuse("model.support equality: a row of all legs")
    forces = qp.P.diagonal().reshape(stages, -1)[:, :INPUTS]
    if np.any(qp.h != 0.0) or np.any(qp.lower[:, 2:INPUTS:3] != 0.0) or np.any(forces <= 0.0):
        _refuse("limits other than friction, or forces without a weight")


def _refuse(form: str) -> NoReturn:
    raise ConfigError(f"mpc.yaml: solver.name = riccati does not cover {form}; take piqp")


def _find_blocks(qp: HorizonQp) -> Blocks:
    a, g = _numbers(qp.A), _numbers(qp.G)
    stages = np.arange(qp.horizon)[:, None]
    legs = np.arange(FEET)
    return Blocks(
        step=a[STATES : STATES + HALF, STAGE - HALF : STAGE],
        gain=np.ascontiguousarray(a[HALF:STATES, :INPUTS].T),
        friction=g[FRICTION_ROWS * stages + 4 * legs, STAGE * stages + 3 * legs + 2],
    )


def _numbers(matrix: sparse.csc_matrix) -> NDArray[np.intp]:
    """(rows, columns) of where each entry stands in `data`, -1 where there is none."""
    numbered = sparse.csc_matrix(
        (np.arange(1.0, matrix.nnz + 1), matrix.indices, matrix.indptr), shape=matrix.shape
    )
    return numbered.toarray().astype(np.intp) - 1


def _iterate(stages: int) -> Iterate:
    forces, sides, states = (stages, FEET, 3), (stages, FEET, SIDES), (stages, STATES)
    curve = (stages, HALF, HALF)
    now, steps = [forces, sides, sides], [forces, sides, sides, sides]
    return Iterate(*map(np.zeros, [*now, *steps, states, states, forces, forces, curve]))


def _factor(stages: int) -> Factor:
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
