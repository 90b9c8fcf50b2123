"""Problem of the rollout MPC: tendon angles over one stride, by one Gauss-Newton step a tick.

The gait gives angles theta_k at the stages k = 0 .. K. The plan deviates from them by b_k; the step
changes it by hat functions h_j, linear between the knots, of one leg each and of all legs together:

    u_k = theta_k + b_k + sum_j delta_j h_j(k)

In a posture one leg alone moves nothing, since the friction of the others holds the torso: all legs
together show what a change that makes them slip would do.

A rollout of the nominal robot from the estimated state gives the poses y_k(u), k = 1 .. K. With the
references r_k, the drift d of the disturbance observer, and the scales S of the errors, the cost is

    sum_k |S^-1 (y_k + k dt d - r_k)|^2 / K + R(u - theta)
    R(b) = sum_k |mean b|^2 / (K deviation^2) + sum_k |b_k - mean b|^2 / (K swing^2)

A payload or a slope needs a mean deviation; a swing about the mean works against the gait.
The errors are linearised by finite differences, a rollout for each j: e(delta) = e + J delta. The
step is damped, since a rollout is linear in small changes only:

    min |e + J delta|^2 + R(b + H delta) + |delta|^2 / change^2
    subject to  low <= u_k <= high,  |u_k - theta_k| <= deviation_max,  |u_k+1 - u_k| <= dt rate

This is the real-time iteration of Diehl, Bock and Schloeder (SIAM J. Control Optim. 43, 2005): one
step a tick, from the last plan, shifted.
"""

from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array, checked
from slot_core.geometry import rotate, wrapped
from slot_core.matrices import interpolated, inverse, norm, product
from slot_core.robot import LEGS
from slot_core.rollout_mpc.active_set import ActiveSet
from slot_core.rollout_mpc.settings import RolloutMpcSettings

LEG_COUNT = len(LEGS)
# FL FR RL RR, and all together
MODES = np.vstack([np.eye(LEG_COUNT), np.ones(LEG_COUNT)])
QP_TOLERANCE = 1e-6  # of the limits, as a share of the largest deviation


class Linearisation(NamedTuple):
    """Slopes of the weighted errors, and inverse of the step's Hessian."""

    slopes: Array  # (n, 6 K) per rad
    inverse: Array  # (n, n)


class PlanProblem:
    """Basis, errors and steps of the plan."""

    def __init__(
        self, settings: RolloutMpcSettings, angle_max: float, dt: float
    ):
        self._settings, self._dt, self._angle_max = settings, dt, angle_max
        stages, cost = settings.stages, settings.cost
        hats = np.array(
            [
                interpolated(np.arange(stages + 1), settings.knots, row)
                for row in np.eye(len(settings.knots))
            ]
        )
        # (n, K + 1, 4)
        self.basis = (hats[None, :, :, None] * MODES[:, None, None, :]).reshape(
            -1, stages + 1, LEG_COUNT
        )
        self._flat = self.basis.reshape(len(self.basis), -1)  # (n, 4 (K + 1))
        rates = np.diff(self.basis, axis=1).reshape(len(self.basis), -1)
        self._rows = np.hstack([self._flat, rates]).T.copy()
        # (6,) of the errors of a pose
        self.scale = np.array(
            [
                cost.tilt,
                cost.tilt,
                cost.yaw,
                cost.place,
                cost.place,
                cost.height,
            ]
        )
        self._times = dt * np.arange(1, stages + 1)  # s, of the stages
        self._weight = 1.0 / (np.sqrt(stages) * self.scale)
        pulls = np.array([self._pull(b).ravel() for b in self.basis])
        damping = np.eye(len(self.basis)) / np.square(cost.change)
        self._damped = product(self._flat, pulls.T) + damping
        self._solver = ActiveSet(len(self.basis))
        slopes = np.zeros((len(self.basis), 6 * stages))
        # compiles the solver
        self.change(
            slopes[0],
            self.linearised(slopes),
            *np.zeros((2, stages + 1, LEG_COUNT)),
        )

    def reference(
        self, rows: Array, place: Array, drift: Array, sag: float
    ) -> Array:
        """Poses (K, 6) that the rollouts are to have, from the preview's reference (n > K, 12).

        The reference leads the robot at place (3,) x, y, yaw by `reach` at most. drift: by the
        observer; sag: m by which the torso sinks. This and the other methods raise ValueError for
        other shapes.
        """
        cost, stages = self._settings.cost, self._settings.stages
        rows = checked("reference", rows, (-1, 12), finite=False)
        if len(rows) <= stages:
            raise ValueError(
                f"reference: {len(rows)} stages, expected more than {stages}"
            )
        place = checked("place", place, (3,))
        drift = checked("drift", drift, (3,))
        gap = rows[0, 3:5] - place[:2]
        beyond = max(0.0, 1.0 - cost.reach / max(norm(gap), 1e-300))
        pose, time = rows[1 : stages + 1, :6].copy(), self._times[:, None]
        # the means of the gait's roll and pitch, added up in turn
        pose[:, :2] = np.cumsum(pose[:, :2] / stages, axis=0)[-1]
        pose[:, 2:3] -= time * drift[2]
        pose[:, 3:5] = (
            pose[:, 3:5] - beyond * gap - rotate(time * drift[:2], place[2])
        )
        pose[:, 5] -= sag
        return pose

    def moved(self, drift: Array, yaw: float) -> Array:
        """Way (K, 3) in x, y (m) and yaw (rad) by which the drift takes the robot in the stages."""
        time = self._times[:, None]
        return np.hstack([time * rotate(drift[:2], yaw), time * drift[2]])

    def varied(self, angle: Array) -> tuple[Array, Array]:
        """Plans (n + 1, K + 1, 4) for finite differences, and their steps (n,), rad.

        The first one has the angles (K + 1, 4); each other one is a step from it along a direction
        of the basis, downward where it would pass the largest angle.
        """
        step = self._settings.step
        beyond = (angle + step * self.basis > self._angle_max).any(axis=(1, 2))
        steps = np.where(beyond, -step, step)
        return np.vstack(
            [angle[None], angle + steps[:, None, None] * self.basis]
        ), steps

    def errors(self, pose: Array, reference: Array, yaw: float) -> Array:
        """Weighted errors (P, 6 K) of poses (P, K, 6), x and y along and across the heading."""
        reference = checked("reference", reference, (-1, 6), finite=False)
        pose = checked("pose", pose, (-1, *reference.shape), finite=False)
        error = pose - reference
        error[..., 2] = wrapped(error[..., 2])
        error[..., 3:5] = rotate(error[..., 3:5], -yaw)
        return (error * self._weight).reshape(len(pose), -1)

    def cost(self, error: Array, deviation: Array) -> float:
        """Cost of errors (6 K,) and deviations (K + 1, 4)."""
        return float(
            (error * error).sum() + (deviation * self._pull(deviation)).sum()
        )

    def _pull(self, deviation: Array) -> Array:
        """Half the gradient (K + 1, 4) of the cost of deviations (K + 1, 4)."""
        cost, mean = self._settings.cost, deviation.sum(axis=0) / len(deviation)
        swing = (deviation - mean) / np.square(cost.swing)
        pull = swing + mean / np.square(cost.deviation)
        return np.asarray(pull / self._settings.stages)

    def linearised(self, slopes: Array) -> Linearisation:
        """Linearisation with the slopes (n, 6 K) of the weighted errors, per rad."""
        hessian = product(slopes, slopes.T) + self._damped
        return Linearisation(slopes, inverse(hessian))

    def change(
        self,
        error: Array,
        linear: Linearisation,
        deviation: Array,
        nominal: Array,
    ) -> Array | None:
        """Change (K + 1, 4) of the deviations by the step; None if the QP is not solved.

        error (6 K,) and linearisation of the rollout with the deviations (K + 1, 4) from the
        nominal angles (K + 1, 4). A limit that the plan violates already stays where it is.
        """
        shape = (self._settings.stages + 1, LEG_COUNT)
        nominal = checked("nominal", nominal, shape)
        deviation = checked("deviation", deviation, shape)
        limits, (least, largest) = self._settings.limits, self.range(nominal)
        # of the changes of the angles, then of their differences between two stages
        low = np.maximum(least - nominal, -limits.deviation) - deviation
        high = np.minimum(largest - nominal, limits.deviation) - deviation
        rise, step = np.diff(nominal, axis=0), self._dt * limits.rate
        change = np.diff(deviation, axis=0)
        slower = np.minimum(-step - rise, 0.0) - change
        faster = np.maximum(step - rise, 0.0) - change
        pull = product(self._flat, self._pull(deviation).ravel())
        delta = self._solver.solve(
            linear.inverse,
            product(linear.slopes, error) + pull,
            self._rows,
            np.minimum(np.concatenate([low, slower]).ravel(), 0.0),
            np.maximum(np.concatenate([high, faster]).ravel(), 0.0),
            QP_TOLERANCE * limits.deviation,
        )
        return (
            None if delta is None else product(delta, self._flat).reshape(shape)
        )

    def range(self, nominal: Array) -> tuple[float, float]:
        """Least and largest tendon angle of a plan around the nominal angles, rad."""
        least = min(self._settings.limits.angle_min, float(nominal.min()))
        return least, self._angle_max
