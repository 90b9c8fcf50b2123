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

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array, checked
from slot_core.compiled import kernel
from slot_core.elementary import cos, sin
from slot_core.geometry import rotate
from slot_core.matrices import interpolated, inverse, product
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
        basis = hats[None, :, :, None] * MODES[:, None, None, :]
        self.basis = basis.reshape(-1, stages + 1, LEG_COUNT)  # (n, K + 1, 4)
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
        self._weight = 1.0 / (np.sqrt(stages) * self.scale)
        pulls = np.array([self._pull(b).ravel() for b in self.basis])
        damping = np.eye(len(self.basis)) / np.square(cost.change)
        self._damped = product(self._flat, pulls.T) + damping
        self._solver = ActiveSet(len(self.basis))
        wanted = self.reference(
            np.zeros((stages + 1, 12)), np.zeros(3), np.zeros(3), 0.0
        )
        # compiles the kernels, as does the step
        error = self.errors(wanted[None], wanted, 0.0)[0]
        slopes = np.zeros((len(self.basis), error.size))
        angle = np.zeros((stages + 1, LEG_COUNT))
        self.change(error, self.linearised(slopes), angle, angle)

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
        pose = np.empty((stages, 6))
        set_reference(
            rows,
            checked("place", place, (3,)),
            checked("drift", drift, (3,)),
            sag,
            self._dt,
            cost.reach,
            pose,
        )
        return pose

    def moved(self, drift: Array, yaw: float) -> Array:
        """Way (K, 3) in x, y (m) and yaw (rad) by which the drift takes the robot in the stages."""
        time = self._dt * np.arange(1, self._settings.stages + 1)[:, None]
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
        error = np.empty(pose.shape)
        set_errors(pose, reference, self._weight, yaw, error)
        return error.reshape(len(pose), -1)

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
        limits = self._settings.limits
        low, high = np.empty((2, len(self._rows)))
        set_limits(
            nominal,
            deviation,
            *self.range(nominal),
            limits.deviation,
            self._dt * limits.rate,
            low,
            high,
        )
        pull = product(self._flat, self._pull(deviation).ravel())
        delta = self._solver.solve(
            linear.inverse,
            product(linear.slopes, error) + pull,
            self._rows,
            low,
            high,
            QP_TOLERANCE * limits.deviation,
        )
        return (
            None if delta is None else product(delta, self._flat).reshape(shape)
        )

    def range(self, nominal: Array) -> tuple[float, float]:
        """Least and largest tendon angle of a plan around the nominal angles, rad."""
        least = min(self._settings.limits.angle_min, float(nominal.min()))
        return least, self._angle_max


@kernel
def set_reference(rows, place, drift, sag, dt, reach, pose):
    """Write the poses (K, 6) that the rollouts are to have, from a preview's reference (n, 12).

    place: x, y (m), yaw (rad) of the robot; drift: v_x, v_y (m/s), yaw rate (rad/s), heading frame;
    sag: m by which the torso is lower; reach: m. Roll and pitch are the means of the gait's.
    """
    count = pose.shape[0]
    roll = pitch = 0.0
    for k in range(count):
        roll += rows[k + 1, 0] / count
        pitch += rows[k + 1, 1] / count
    ahead, aside = rows[0, 3] - place[0], rows[0, 4] - place[1]
    distance = math.sqrt(ahead * ahead + aside * aside)
    share = 1.0 - reach / distance if distance > reach else 0.0
    c, s = cos(place[2]), sin(place[2])
    for k in range(count):
        row, time = rows[k + 1], dt * (k + 1)
        x, y = time * drift[0], time * drift[1]
        pose[k, 0], pose[k, 1] = roll, pitch
        pose[k, 2] = row[2] - time * drift[2]
        pose[k, 3] = row[3] - share * ahead - (c * x - s * y)
        pose[k, 4] = row[4] - share * aside - (s * x + c * y)
        pose[k, 5] = row[5] - sag


@kernel
def set_errors(pose, reference, w, yaw, error):
    """Write errors (P, K, 6) of poses (P, K, 6), x and y along and across the heading.

    w: (6,) weights of the errors.
    """
    c, s = cos(yaw), sin(yaw)
    for p in range(pose.shape[0]):
        for k in range(pose.shape[1]):
            is_, should, e = pose[p, k], reference[k], error[p, k]
            x, y = is_[3] - should[3], is_[4] - should[4]
            turn = is_[2] - should[2] + math.pi
            turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi)) + math.pi
            e[0], e[1], e[2] = (
                (is_[0] - should[0]) * w[0],
                (is_[1] - should[1]) * w[1],
                turn * w[2],
            )
            e[3], e[4] = (c * x + s * y) * w[3], (c * y - s * x) * w[4]
            e[5] = (is_[5] - should[5]) * w[5]


@kernel
def set_limits(nominal, deviation, least, largest, most, step, low, high):
    """Write the limits (8 K + 4,) of the changes of a plan's angles, then of their differences.

    nominal, deviation: (K + 1, 4) rad; least, largest: of an angle, rad; most: largest deviation,
    rad; step: largest difference between two stages, rad. What the plan violates already may stay.
    """
    count = nominal.size
    for k in range(nominal.shape[0]):
        for leg in range(4):
            i, angle, b = 4 * k + leg, nominal[k, leg], deviation[k, leg]
            low[i] = min(max(least - angle, -most) - b, 0.0)
            high[i] = max(min(largest - angle, most) - b, 0.0)
            if k + 1 < nominal.shape[0]:
                rise, change = (
                    nominal[k + 1, leg] - angle,
                    deviation[k + 1, leg] - b,
                )
                low[count + i] = min(min(-step - rise, 0.0) - change, 0.0)
                high[count + i] = max(max(step - rise, 0.0) - change, 0.0)
