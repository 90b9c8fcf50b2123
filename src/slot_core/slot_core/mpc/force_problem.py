"""Problem of the MPC on ground reaction forces: its quadratic programme and solver.

The paper's formulation, made well posed, for comparison. It takes the legs as ideal sources of
force (`model.py`), which soft legs are not. As printed and as published: `slot_paper`.

The solver is Clarabel, an interior-point method (Goulart and Chen, 2024). It starts cold and is
plain Rust with one order of operations: every processor gives the same bits.
"""

import math
from dataclasses import dataclass

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from slot_core.arrays import Array
from slot_core.control.policy import STAGE_TIME
from slot_core.gait.gait import GaitPreview
from slot_core.matrices import product, sparse_product
from slot_core.mpc.model import (
    FEET,
    INPUTS,
    STAGE,
    STATES,
    FirstStage,
    Horizon,
    Prediction,
    TorsoModel,
    turned_to,
)
from slot_core.mpc.settings import MpcSettings, MpcSolverSettings
from slot_core.robot import RobotParameters


@dataclass(frozen=True)
class Solution:
    """Result of the solver."""

    z: Array  # the variables
    fault: str  # one line, empty if solved
    iterations: int


class ForceProblem:
    """Quadratic programme with the values of the present tick; its solver starts cold.

        min 1/2 z'Pz + c'z   subject to   C z + s = d,   z = [u_0, x_1, u_1, x_2, ...]

    Rows of C: the dynamics, with s = 0; then, with s >= 0, friction, f_z >= 0 and f_z <= f_max of
    every stage and leg. P and the sparsity of C are constant.
    """

    def __init__(self, robot: RobotParameters, settings: MpcSettings):
        """Set up problem and solver."""
        self._settings, self.mass = settings, robot.mass
        self._model = TorsoModel(robot)
        self.horizon = n = settings.horizon
        # A prediction that is non-zero wherever any prediction is.
        generic = self._model.predict(0.3, 0.1, STAGE_TIME[1])
        # diagonal of P
        self.weight = np.tile([*settings.weights.r, *settings.weights.q], n)
        self.target = np.zeros((n, STAGE))
        rows = _rows(n, generic)
        self.matrix = sparse.csc_matrix(rows.astype(float))  # C
        # of its entries' values
        self._slots = self.matrix.data.astype(np.intp) - 1
        self.right = np.zeros(len(rows))  # d
        feet, forces = np.zeros((n, FEET)), np.zeros((n, FEET, 3))
        self._ahead = Horizon(feet, feet, forces, np.zeros((n, STATES)))
        self._set(generic, np.zeros(STATES))
        self._solver = clarabel.DefaultSolver(
            sparse.diags(self.weight, format="csc"),
            self.c,
            self.matrix,
            self.right,
            [
                clarabel.ZeroConeT(n * STATES),
                clarabel.NonnegativeConeT(len(rows) - n * STATES),
            ],
            options(settings.solver),
        )
        self.solve()  # the first solve is slow (page faults): not during operation

    @property
    def c(self) -> Array:
        """Linear cost -P z_ref."""
        return -self.weight * self.target.ravel()

    def read(self, preview: GaitPreview) -> FirstStage:
        """Take the limits and targets of a preview; return the first stage's.

        If the preview ends with stage H-1, its reference there is the target of state H too.
        """
        now = np.arange(self.horizon)
        following = np.minimum(now + 1, len(preview.reference) - 1)
        force = np.zeros((len(now), FEET, 3))
        force[..., 2] = np.asarray(preview.normal_force)[now]
        contact = np.asarray(preview.contact, dtype=float)[now]
        self._ahead = ahead = Horizon(
            force_max=self._settings.force_max * contact,
            friction=np.asarray(preview.friction, dtype=float)[now],
            force_ref=force,
            state_ref=np.asarray(preview.reference, dtype=float)[following],
        )
        return FirstStage(
            ahead.force_max[0], ahead.friction[0], force[0], preview.rate
        )

    def update(self, state: Array, preview: GaitPreview) -> None:
        """Set the present state (12,), at stage 0 of the preview that was read.

        The yaw of the targets is shifted by the full turns that bring it nearest to the state's.
        """
        self._set(self._model.predict(state[2], state[5], preview.dt), state)

    def _set(self, prediction: Prediction, state: Array) -> None:
        """Set C, d and the targets for a prediction from a state (12,) and the stages ahead."""
        stages = self._ahead
        values = np.concatenate(
            [
                [1.0, -1.0],
                -prediction.a.ravel(),
                -prediction.b.ravel(),
                -stages.friction.ravel(),
            ]
        )
        self.matrix.data[:] = values[self._slots]
        dynamics = self.right[: self.horizon * STATES].reshape(
            self.horizon, STATES
        )
        dynamics[:] = prediction.drift
        dynamics[0] += product(prediction.a, state)
        self.right[-self.horizon * FEET :] = stages.force_max.ravel()
        self.target[:, :INPUTS] = stages.force_ref.reshape(-1, INPUTS)
        self.target[:, INPUTS:] = turned_to(stages.state_ref, state)

    def solve(self) -> Solution:
        """Solve the problem with its present values; raises nothing."""
        self._solver.update(q=self.c, A=self.matrix.data, b=self.right)
        return solution_of(self._solver)

    def balance(self, force: Array) -> float:
        """Slack of the balance of forces (4, 3) with the weight: infinite, without such a limit."""
        return math.inf

    def forces(self, z: Array) -> Array:
        """Forces (H, 4, 3) N: the inputs in z."""
        return (
            z.reshape(self.horizon, STAGE)[:, :INPUTS]
            .reshape(-1, FEET, 3)
            .copy()
        )

    def cost(self, z: Array) -> float:
        """Objective of `model.py` at z."""
        error = z - self.target.ravel()
        return float((error * (self.weight * error)).sum())

    def violation(self, z: Array) -> float:
        """Largest violation of a limit of the forces, N; zero if there is none."""
        return float(max(0.0, self._excess(z)[self.horizon * STATES :].max()))

    def residual(self, z: Array) -> float:
        """Largest error of the dynamics over the stages, SI units."""
        return float(np.abs(self._excess(z)[: self.horizon * STATES]).max())

    def _excess(self, z: Array) -> Array:
        """C z - d."""
        return sparse_product(self.matrix, z) - self.right


def _rows(horizon: int, pattern: Prediction) -> NDArray[np.int64]:
    """Rows of C; an entry is the 1-based index of its value in [1, -1, -a, -b, -mu], or 0.

    pattern: a prediction that is non-zero wherever any prediction is.
    """
    entries = STATES * (STATES + INPUTS)  # of a and b
    number = 3 + np.arange(entries + horizon * FEET)
    of_a, of_b, of_mu = np.split(number, [STATES * STATES, entries])
    a = np.where(pattern.a != 0, of_a.reshape(STATES, STATES), 0)
    b = np.where(pattern.b != 0, of_b.reshape(STATES, INPUTS), 0)
    dynamics = np.zeros((horizon, STATES, horizon, STAGE), dtype=np.int64)
    friction = np.zeros((horizon, FEET, 4, horizon, STAGE), dtype=np.int64)
    least, largest = np.zeros(
        (2, horizon, FEET, horizon, STAGE), dtype=np.int64
    )
    for k in range(horizon):
        dynamics[k, :, k, :INPUTS] = b
        dynamics[k, :, k, INPUTS:] = np.eye(STATES)
        if k > 0:
            dynamics[k, :, k - 1, INPUTS:] = a
        for leg in range(FEET):  # +-f_x - mu f_z <= 0, +-f_y - mu f_z <= 0
            f_x, f_z = 3 * leg, 3 * leg + 2
            friction[k, leg, :, k, f_x:f_z] = [[1, 0], [2, 0], [0, 1], [0, 2]]
            friction[k, leg, :, k, f_z] = of_mu[k * FEET + leg]
            least[k, leg, k, f_z] = 2
            largest[k, leg, k, f_z] = 1
    parts = dynamics, friction, least, largest
    return np.vstack([part.reshape(-1, horizon * STAGE) for part in parts])


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
