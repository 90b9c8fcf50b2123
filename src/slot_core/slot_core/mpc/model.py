"""Problem of the convex MPC: torso model, horizon and quadratic programme.

State x = [roll pitch yaw, p, omega, v] (12,) and input u = (4, 3) ground reaction forces, both in
odom. The model is a single rigid body (Di Carlo et al., IROS 2018); the feet are placed as those of
stress-free legs:

    d/dt rpy = R_z(yaw)^T omega        omega' = I_w^-1 sum r_i x f_i
    d/dt p   = v                       v'     = sum f_i / m - g e_z

with I_w = R_z I R_z^T of torso and legs, r_i = R_z foot_i horizontally and r_z = -p_z, at the yaw
and height of the present state; the inputs u are the forces f. Over the stages k = 0 .. H-1 of the
gait preview the MPC minimises

    sum (x_k+1 - x_ref,k+1)' Q (x_k+1 - x_ref,k+1) + (u_k - u_ref,k)' R (u_k - u_ref,k)
    with  0 <= f_z <= contact f_max   and   |f_x|, |f_y| <= mu f_z   for every leg and stage,

with u_ref the gait's normal forces. u = 0 is always allowed: the problem is feasible from every
state. That of the paper, which balances the weight in every stage, is in `paper_problem.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from slot_core.arrays import Array
from slot_core.elementary import cos, sin
from slot_core.matrices import inverse, product, sparse_product
from slot_core.robot import GRAVITY, LEGS, RobotParameters

FEET = len(LEGS)
STATES = 12
INPUTS = 3 * FEET
STAGE = INPUTS + STATES  # variables of a stage
F_Z = slice(2, INPUTS, 3)
YAW = 2

Slots = NDArray[np.intp]


@dataclass(frozen=True)
class Prediction:
    """Discrete model x_k+1 = a x_k + b u_k + drift."""

    a: Array  # (12, 12)
    b: Array  # (12, 12)
    drift: Array  # (12,) effect of gravity in one stage


@dataclass(frozen=True)
class Horizon:
    """Limits and input targets of the stages 0 .. H-1; state targets of the stages 1 .. H."""

    force_max: Array  # (H, 4) N, zero without contact
    friction: Array  # (H, 4)
    force_ref: Array  # (H, 4, 3) N
    state_ref: Array  # (H, 12)


@dataclass(frozen=True)
class FirstStage:
    """Limits and reference inputs of stage 0 of the newest valid preview."""

    force_max: Array  # (4,) N
    friction: Array  # (4,)
    force_ref: Array  # (4, 3) N
    rate: Array  # (4,) rad/s, of the gait's tendon angles

    def clip(self, force: Array) -> Array:
        """Forces (4, 3) N clipped to the limits, the normal forces first."""
        normal = np.clip(force[:, 2:], 0.0, self.force_max[:, None])
        limit = self.friction[:, None] * normal
        return np.hstack([np.clip(force[:, :2], -limit, limit), normal])

    def slacks(self, force: Array) -> Array:
        """Slacks (3, 4) N of forces (4, 3) N: f_z, f_max - f_z and mu f_z - max(|f_x|, |f_y|).

        Negative means violated.
        """
        normal, tangential = force[:, 2], np.abs(force[:, :2]).max(axis=1)
        return np.stack(
            [normal, self.force_max - normal, self.friction * normal - tangential]
        )


class TorsoModel:
    """Single rigid body model of the torso, driven by the forces on its feet."""

    def __init__(self, robot: RobotParameters):
        self._feet = robot.feet
        self._inverse_inertia = inverse(robot.inertia)
        self._mass = robot.mass

    def predict(self, yaw: float, height: float, dt: float) -> Prediction:
        """Discretise exactly, by zero-order hold over dt (s), at a yaw (rad) and height (m).

        With q = [rpy, p] and w = [omega, v] the model is q' = J w, w' = W u + g.
        """
        rotation = rotation_z(yaw)
        jacobian = np.eye(6)
        jacobian[:3, :3] = rotation.T
        gain = np.zeros((6, INPUTS))
        levers = product(self._feet, rotation.T)
        levers[:, 2] = -height
        arms = lever_arms(levers)
        turned = product(product(rotation, self._inverse_inertia), rotation.T)
        gain[:3] = product(turned, arms)
        gain[3:] = np.tile(np.eye(3) / self._mass, FEET)
        acceleration = np.zeros(6)
        acceleration[5] = -GRAVITY
        a, b, drift = np.eye(STATES), np.zeros((STATES, INPUTS)), np.zeros(STATES)
        a[:6, 6:] = dt * jacobian
        b[:6] = dt * dt / 2 * product(jacobian, gain)
        b[6:] = dt * gain
        drift[:6] = dt * dt / 2 * product(jacobian, acceleration)
        drift[6:] = dt * acceleration
        return Prediction(a, b, drift)


class HorizonQp:
    """Quadratic programme min 1/2 z'Pz + c'z with A z = b, G z <= h, lower <= z <= upper.

    z = [u_0, x_1, u_1, x_2, ...]. The arrays are scipy CSC matrices and vectors, updated in place;
    P and all sparsity patterns are constant. Rows of A: dynamics. Rows of G: friction.
    """

    def __init__(self, q: Array, r: Array, horizon: int, pattern: Prediction):
        """Lay out the arrays.

        q (12,) and r (12,): diagonals of Q and R. pattern: a prediction that is non-zero wherever
        any prediction is.
        """
        self.horizon = horizon
        self.weight = np.tile(np.concatenate([r, q]), horizon)
        self.P = sparse.diags(self.weight, format="csc")
        rows = _Rows(horizon, pattern)
        self.A, self._a_slots = _indexed(rows.dynamics())
        self.G, self._g_slots = _indexed(rows.friction())
        self.b = np.zeros(self.A.shape[0])
        self.h = np.zeros(self.G.shape[0])
        self.lower = np.full((horizon, STAGE), -np.inf)
        self.lower[:, F_Z] = 0.0
        self.upper = np.full((horizon, STAGE), np.inf)
        self.target = np.zeros((horizon, STAGE))
        feet = np.zeros((horizon, FEET))
        forces, states = np.zeros((horizon, FEET, 3)), np.zeros((horizon, STATES))
        self.update(pattern, np.zeros(STATES), Horizon(feet, feet, forces, states))

    @property
    def c(self) -> Array:
        """Linear cost -W z_ref."""
        return (-self.weight.reshape(self.horizon, -1) * self.target).ravel()

    def update(self, prediction: Prediction, state: Array, stages: Horizon) -> None:
        """Set prediction, present state (12,) and stages ahead.

        The yaw of the targets is shifted by the full turns that bring it nearest to the state's.
        """
        friction = -stages.friction.ravel()
        values = np.concatenate(
            [[1.0, -1.0], -prediction.a.ravel(), -prediction.b.ravel()]
        )
        self.A.data[:] = values[self._a_slots]
        self.G.data[:] = np.concatenate([[1.0, -1.0], friction])[self._g_slots]
        dynamics = self.b.reshape(self.horizon, -1)
        dynamics[:] = prediction.drift
        dynamics[0] += product(prediction.a, state)
        self.upper[:, F_Z] = stages.force_max
        self.target[:, :INPUTS] = stages.force_ref.reshape(-1, INPUTS)
        self.target[:, INPUTS:] = turned_to(stages.state_ref, state)

    def forces(self, z: Array) -> Array:
        """Forces (H, 4, 3) N: the inputs in z."""
        return z.reshape(self.horizon, STAGE)[:, :INPUTS].reshape(-1, FEET, 3).copy()

    def cost(self, z: Array) -> float:
        """Objective of the module's docstring at z."""
        error = z - self.target.ravel()
        return float((error * (self.weight * error)).sum())

    def violation(self, z: Array) -> float:
        """Largest violation of a limit of the inputs, N; zero if there is none."""
        inputs = slice(0, INPUTS)
        flat = z.reshape(self.horizon, STAGE)[:, inputs]
        outside = [
            (sparse_product(self.G, z) - self.h).max(),
            (self.lower[:, inputs] - flat).max(),
            (flat - self.upper[:, inputs]).max(),
        ]
        return float(max(0.0, *outside))

    def residual(self, z: Array) -> float:
        """Largest error of the dynamics over the stages, SI units."""
        return float(np.abs(sparse_product(self.A, z) - self.b).max())


class _Rows:
    """Constraint rows; an entry is the 1-based index of its value in a list, 0 for a zero."""

    def __init__(self, horizon: int, pattern: Prediction):
        self._horizon, self._pattern = horizon, pattern

    def dynamics(self) -> NDArray[np.int64]:
        """x_k+1 - a x_k - b u_k = drift; values [1, -1, -a, -b]."""
        size = STATES
        number = 3 + np.arange(size * (size + INPUTS))
        a = np.where(self._pattern.a != 0, number[: size * size].reshape(size, size), 0)
        b = np.where(
            self._pattern.b != 0, number[size * size :].reshape(size, INPUTS), 0
        )
        rows = self._empty(size)
        for k in range(self._horizon):
            rows[k, :, k, :INPUTS] = b
            rows[k, :, k, INPUTS:] = np.eye(size)
            if k > 0:
                rows[k, :, k - 1, INPUTS:] = a
        return self._flat(rows)

    def friction(self) -> NDArray[np.int64]:
        """+-f_x - mu f_z <= 0 and +-f_y - mu f_z <= 0; values [1, -1, -mu]."""
        rows = self._empty(FEET * 4)
        for k, leg in np.ndindex(self._horizon, FEET):
            block = rows[k, 4 * leg : 4 * leg + 4, k, 3 * leg : 3 * leg + 3]
            block[:, :2] = [[1, 0], [2, 0], [0, 1], [0, 2]]
            block[:, 2] = 3 + k * FEET + leg
        return self._flat(rows)

    def _empty(self, count: int) -> NDArray[np.int64]:
        return np.zeros((self._horizon, count, self._horizon, STAGE), dtype=np.int64)

    def _flat(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        return rows.reshape(rows.shape[0] * rows.shape[1], -1)


def turned_to(reference: Array, state: Array) -> Array:
    """The reference (n, 12), its yaw shifted by the full turns to the nearest of a state (12,)."""
    shifted = reference.copy()
    turns = np.round((state[YAW] - reference[0, YAW]) / (2 * np.pi))
    shifted[:, YAW] += 2 * np.pi * turns
    return shifted


def condensed_condition(
    prediction: Prediction, q: Array, r: Array, horizon: int
) -> float:
    """Condition number of the condensed Hessian S'QS + R (states eliminated: x = S u + ..).

    If it is large, the objective is flat in some directions: roundoff and the solver's tolerance
    then appear in the forces. q (12,) and r (12,): diagonals of Q and R.
    """
    columns = np.zeros((horizon, STATES, INPUTS))  # first block column of S
    block = prediction.b
    for k in range(horizon):
        columns[k] = block
        block = prediction.a @ block
    s = np.zeros((horizon * STATES, horizon * INPUTS))
    for k in range(horizon):
        s[k * STATES :, k * INPUTS : (k + 1) * INPUTS] = columns[: horizon - k].reshape(
            -1, INPUTS
        )
    hessian = s.T @ (np.tile(q, horizon)[:, None] * s) + np.diag(np.tile(r, horizon))
    eigenvalues = np.linalg.eigvalsh(hessian)
    return float(eigenvalues[-1] / max(eigenvalues[0], np.finfo(float).tiny))


def rotation_z(yaw: float) -> Array:
    """R_z(yaw) (3, 3)."""
    s, c = sin(yaw), cos(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def lever_arms(levers: Array) -> Array:
    """Matrices [r_1]x .. [r_4]x (3, 12) of levers (4, 3) m."""
    arms = np.zeros((3, INPUTS))
    x, y, z = levers.T
    arms[0, 1::3], arms[0, 2::3] = -z, y
    arms[1, 0::3], arms[1, 2::3] = z, -x
    arms[2, 0::3], arms[2, 1::3] = -y, x
    return arms


def _indexed(rows: NDArray[np.int64]) -> tuple[sparse.csc_matrix, Slots]:
    """Matrix with the sparsity of the rows, and for each entry the 0-based index of its value."""
    matrix = sparse.csc_matrix(rows.astype(float))
    return matrix, matrix.data.astype(np.intp) - 1
