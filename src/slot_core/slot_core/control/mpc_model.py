"""The convex MPC's problem: torso model, horizon, and the quadratic programme made of them.

State x = [roll pitch yaw, p, omega, v] (12,) and input u = (4, 3) ground reaction forces, both in
odom. A single rigid body (Di Carlo et al., IROS 2018) on feet placed like those of natural legs:

    d/dt rpy = R_z(yaw)^T omega        omega' = I_w^-1 sum r_i x f_i
    d/dt p   = v                       v'     = sum f_i / m - g e_z

with I_w = R_z I R_z^T of torso and legs, r_i = R_z foot_i horizontally and r_z = -p_z, at the yaw
and height of the present state. Over the stages k = 0 .. H-1 of the gait preview it minimises

    sum (x_k+1 - x_ref,k+1)' Q (x_k+1 - x_ref,k+1) + (u_k - u_ref,k)' R (u_k - u_ref,k)
    with  0 <= f_z <= contact f_max   and   |f_x|, |f_y| <= mu f_z   for every leg and stage,

u_ref being the normal forces the gait expects. u = 0 is always allowed: the problem is feasible
from every state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from slot_core.robot import GRAVITY, LEGS, Array, Robot

FEET = len(LEGS)
STATES = 12
INPUTS = 3 * FEET
STAGE = INPUTS + STATES  # of the decision vector z = [u_0, x_1, u_1, x_2, ..., u_H-1, x_H]
F_Z = slice(2, INPUTS, 3)
YAW = 2

Slots = NDArray[np.intp]


@dataclass(frozen=True)
class Prediction:
    """x_k+1 = a x_k + b u_k + drift."""

    a: Array  # (12, 12)
    b: Array  # (12, 12)
    drift: Array  # (12,) what gravity does in one stage


@dataclass(frozen=True)
class Horizon:
    """Limits and targets of the stages 0 .. H-1; the states' targets one stage later."""

    force_max: Array  # (H, 4) N, zero without contact
    friction: Array  # (H, 4)
    force_ref: Array  # (H, 4, 3) N
    state_ref: Array  # (H, 12), of stages 1 .. H


class TorsoModel:
    """Predicts the torso from the forces on its feet."""

    def __init__(self, robot: Robot):
        self._mass = robot.mass
        self._feet = robot.feet
        self._inverse_inertia = np.linalg.inv(robot.inertia)

    def predict(self, yaw: float, height: float, dt: float) -> Prediction:
        """Exact zero-order hold over dt (s) at a yaw (rad) and height (m).

        With q = [rpy, p] and w = [omega, v] the model is q' = J w, w' = W u + g, a double
        integrator: the series of the matrix exponential ends after dt^2.
        """
        turn = _turn(yaw)
        jacobian = np.eye(6)
        jacobian[:3, :3] = turn.T
        gain = np.zeros((6, INPUTS + 1))  # [W, g]
        gain[:3, :INPUTS] = (
            turn @ self._inverse_inertia @ turn.T @ _levers(turn, self._feet, height)
        )
        gain[3:, :INPUTS] = np.tile(np.eye(3) / self._mass, FEET)
        gain[5, INPUTS] = -GRAVITY
        step = np.vstack([dt**2 / 2 * jacobian @ gain, dt * gain])
        a = np.eye(STATES)
        a[:6, 6:] = dt * jacobian
        return Prediction(a, step[:, :INPUTS], step[:, INPUTS])


class HorizonQp:
    """min 1/2 z'Pz + c'z with A z = b, G z <= 0, lower <= z <= upper, updated in place.

    The sparsity never changes; P never does. The arrays are scipy CSC matrices and vectors.
    """

    def __init__(self, q: Array, r: Array, horizon: int, pattern: Prediction):
        """Weights q (12,) and r (12,); `pattern` has a non-zero wherever any prediction has one."""
        self.horizon = horizon
        self.weight = np.tile(np.concatenate([r, q]), horizon)
        self.P = sparse.diags(self.weight, format="csc")
        self.G, self._mu_slots = _friction_rows(horizon)
        self.A, self._a_slots = _dynamics_rows(horizon, pattern)
        self.h = np.zeros(self.G.shape[0])
        self.b = np.zeros((horizon, STATES))
        self.lower = np.full((horizon, STAGE), -np.inf)
        self.lower[:, F_Z] = 0.0
        self.upper = np.full((horizon, STAGE), np.inf)
        self.target = np.zeros((horizon, STAGE))
        feet = np.zeros((horizon, FEET))
        forces, states = np.zeros((horizon, FEET, 3)), np.zeros((horizon, STATES))
        self.update(pattern, np.zeros(STATES), Horizon(feet, feet, forces, states))

    @property
    def c(self) -> Array:
        """(24 H,) linear cost: -P z_ref."""
        return -self.weight * self.target.ravel()

    def update(self, prediction: Prediction, state: Array, stages: Horizon) -> None:
        """Put in a prediction, the present state (12,) and the stages ahead.

        The targets' yaw is turned by as many full turns as bring it next to the state's.
        """
        values = np.concatenate([[1.0], -prediction.a.ravel(), -prediction.b.ravel()])
        self.A.data[:] = values[self._a_slots]
        self.b[:] = prediction.drift
        self.b[0] += prediction.a @ state
        friction = np.concatenate([[1.0, -1.0], -stages.friction.ravel()])
        self.G.data[:] = friction[self._mu_slots]
        self.upper[:, F_Z] = stages.force_max
        self.target[:, :INPUTS] = stages.force_ref.reshape(-1, INPUTS)
        self.target[:, INPUTS:] = stages.state_ref
        turns = np.round((state[YAW] - stages.state_ref[0, YAW]) / (2 * np.pi))
        self.target[:, INPUTS + YAW] += 2 * np.pi * turns

    def forces(self, z: Array) -> Array:
        """(H, 4, 3) N: the inputs in z (24 H,)."""
        return z.reshape(self.horizon, STAGE)[:, :INPUTS].reshape(self.horizon, FEET, 3).copy()

    def cost(self, z: Array) -> float:
        """The objective of the module's docstring at z (24 H,)."""
        error = z - self.target.ravel()
        return float(error @ (self.weight * error))


def slacks(force: Array, force_max: Array, friction: Array) -> Array:
    """(3, ..., 4) N: f_z, f_max - f_z and mu f_z - max(|f_x|, |f_y|); negative is violated.

    `force` is (..., 4, 3), the limits are (..., 4).
    """
    normal = force[..., 2]
    tangential = np.abs(force[..., :2]).max(axis=-1)
    return np.stack([normal, force_max - normal, friction * normal - tangential])


def condensed_condition(prediction: Prediction, q: Array, r: Array, horizon: int) -> float:
    """Condition number of S'QS + R, the Hessian left when the states are eliminated (x = S u + ..).

    Above it, roundoff and the solver's tolerance show in the forces: the objective is flat there.
    """
    columns = np.zeros((horizon, STATES, INPUTS))  # S's first block column
    block = prediction.b
    for k in range(horizon):
        columns[k] = block
        block = prediction.a @ block
    s = np.zeros((horizon * STATES, horizon * INPUTS))
    for k in range(horizon):
        s[k * STATES :, k * INPUTS : (k + 1) * INPUTS] = columns[: horizon - k].reshape(-1, INPUTS)
    hessian = s.T @ (np.tile(q, horizon)[:, None] * s) + np.diag(np.tile(r, horizon))
    eigenvalues = np.linalg.eigvalsh(hessian)
    return float(eigenvalues[-1] / max(eigenvalues[0], np.finfo(float).tiny))


def _turn(yaw: float) -> Array:
    """(3, 3) R_z(yaw)."""
    s, c = np.sin(yaw), np.cos(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _levers(turn: Array, feet: Array, height: float) -> Array:
    """(3, 12) [r_1]x .. [r_4]x, feet on the floor `height` below the centre."""
    levers = np.zeros((3, INPUTS))
    x, y, _ = turn @ feet.T
    levers[0, 1::3], levers[0, 2::3] = height, y
    levers[1, 0::3], levers[1, 2::3] = -height, -x
    levers[2, 0::3], levers[2, 1::3] = -y, x
    return levers


def _dynamics_rows(horizon: int, pattern: Prediction) -> tuple[sparse.csc_matrix, Slots]:
    """A of x_k+1 - a x_k - b u_k = drift; its entries are out of [1, -a, -b]."""
    number = 2 + np.arange(STATES * (STATES + INPUTS))
    a = np.where(pattern.a != 0, number[: STATES**2].reshape(STATES, STATES), 0)
    b = np.where(pattern.b != 0, number[STATES**2 :].reshape(STATES, INPUTS), 0)
    rows = np.zeros((horizon, STATES, horizon, STAGE), dtype=np.int64)
    for k in range(horizon):
        rows[k, :, k, :INPUTS] = b
        rows[k, :, k, INPUTS:] = np.eye(STATES)
        if k > 0:
            rows[k, :, k - 1, INPUTS:] = a
    return _numbered(rows.reshape(horizon * STATES, -1))


def _friction_rows(horizon: int) -> tuple[sparse.csc_matrix, Slots]:
    """G of +-f_x - mu f_z <= 0 and +-f_y - mu f_z <= 0; its entries are out of [1, -1, -mu]."""
    rows = np.zeros((horizon, FEET, 4, horizon, FEET, 3), dtype=np.int64)
    for k, leg in np.ndindex(horizon, FEET):
        rows[k, leg, :, k, leg, :2] = [[1, 0], [2, 0], [0, 1], [0, 2]]
        rows[k, leg, :, k, leg, 2] = 3 + k * FEET + leg
    inputs = rows.reshape(horizon * 4 * FEET, horizon, INPUTS)
    states = np.zeros((len(inputs), horizon, STATES), dtype=np.int64)
    return _numbered(np.concatenate([inputs, states], axis=2).reshape(len(inputs), -1))


def _numbered(numbers: NDArray[np.int64]) -> tuple[sparse.csc_matrix, Slots]:
    """A matrix with the non-zeros of `numbers`, and where each entry's value stands: number - 1."""
    matrix = sparse.csc_matrix(numbers.astype(float))
    return matrix, matrix.data.astype(np.intp) - 1
