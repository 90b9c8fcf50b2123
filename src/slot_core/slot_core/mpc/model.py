"""Torso model of the convex MPC, and the limits and targets of its horizon.

State x = [roll pitch yaw, p, omega, v] (12,) and input u = (4, 3) ground reaction forces, both in
odom. The model is a single rigid body (Di Carlo et al., IROS 2018); the feet are placed as on
stress-free legs:

    d/dt rpy = R_z(yaw)^T omega        omega' = I_w^-1 sum r_i x f_i
    d/dt p   = v                       v'     = sum f_i / m - g e_z

with I_w = R_z I R_z^T of torso and legs, r_i = R_z foot_i horizontally and r_z = -p_z, at the yaw
and height of the present state; the inputs u are the forces f. Over the stages k = 0 .. H-1 of the
gait preview the MPC minimises

    sum (x_k+1 - x_ref,k+1)' Q (x_k+1 - x_ref,k+1) + (u_k - u_ref,k)' R (u_k - u_ref,k)
    with  0 <= f_z <= contact f_max   and   |f_x|, |f_y| <= mu f_z   for every leg and stage,

with u_ref the gait's normal forces. u = 0 is always allowed: the problem is feasible from every
state.
"""

from dataclasses import dataclass

import numpy as np

from slot_core.arrays import Array
from slot_core.geometry import matrix_of_rpy
from slot_core.matrices import inverse, product
from slot_core.robot import GRAVITY, LEGS, RobotParameters

FEET = len(LEGS)
STATES = 12
INPUTS = 3 * FEET
STAGE = INPUTS + STATES  # variables of a stage
YAW = 2


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
            [
                normal,
                self.force_max - normal,
                self.friction * normal - tangential,
            ]
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
        rotation = matrix_of_rpy([0.0, 0.0, yaw])  # R_z
        jacobian = np.eye(6)
        jacobian[:3, :3] = rotation.T
        gain = np.zeros((6, INPUTS))
        levers = product(self._feet, rotation.T)
        levers[:, 2] = -height
        turned = product(product(rotation, self._inverse_inertia), rotation.T)
        gain[:3] = product(turned, lever_arms(levers))
        gain[3:] = np.tile(np.eye(3) / self._mass, FEET)
        acceleration = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY])
        a, half = np.eye(STATES), dt * dt / 2
        a[:6, 6:] = dt * jacobian
        moved = half * product(jacobian, acceleration)
        return Prediction(
            a,
            b=np.vstack([half * product(jacobian, gain), dt * gain]),
            drift=np.append(moved, dt * acceleration),
        )


def turned_to(reference: Array, state: Array) -> Array:
    """The reference (n, 12), its yaw shifted by the full turns to the nearest of a state (12,)."""
    shifted = reference.copy()
    shifted[:, YAW] += (
        2 * np.pi * np.round((state[YAW] - reference[0, YAW]) / (2 * np.pi))
    )
    return shifted


def lever_arms(levers: Array) -> Array:
    """Matrices [r_1]x .. [r_4]x (3, 12) of levers (4, 3) m."""
    return np.cross(levers[:, None], np.eye(3)).reshape(INPUTS, 3).T.copy()
