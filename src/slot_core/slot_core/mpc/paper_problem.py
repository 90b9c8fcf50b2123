"""Problem of the paper's MPC, as printed (`paper_text`) and as in its authors' walk (`paper_code`).

    minimise    sum_k=0^H-1 (x_k - x_ref,k)' Q (x_k - x_ref,k) + u_k' R u_k
                + sum of the front legs w (f_x - a)^2
    subject to  x_k+1 = x_k + dt (A x_k + B u_k - g e_vz)
                |sum f_z - m g| <= band,  least <= f_z <= f_max
                |f_x|, |f_y| <= mu f_z,   of the rear legs of paper_code |(f_x, f_y)| <= mu f_z

A has the drag of the velocity, B the levers r_i of the forces: in print those of the attachments,
turned with the present yaw as the inertia; in the scripts of feet twice a leg's length away, not
turned. The torso is a box of the robot's mass. The last input drives a state without cost.

The front legs take turns, each pulled for half a stride, FL first: mu is that of a pulled, a
released or a rear leg, all at the present phase of the gait, for all stages. A robot that is to
stand pulls none. paper_code limits and weighs the forces in the legs' axes: the pulled leg has
a = pull and f_x >= least_pull, the released one a = 0, and all but the pulled one f_z >=
least_normal. No leg is lifted: three legs of f_max = 6 N do not carry the weight. The gait gives
the references; those of the scripts are 0.02 m/s and 0.1 m.

The print leaves the discretisation open; explicit Euler and the mass of the whole robot are the
scripts'.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from slot_core.arrays import Array
from slot_core.elementary import cos, hypot, sin
from slot_core.gait.gait import GaitPreview
from slot_core.matrices import inverse, norm, product, sparse_product
from slot_core.mpc.model import (
    FEET,
    INPUTS,
    STAGE,
    STATES,
    FirstStage,
    Prediction,
    lever_arms,
    rotation_z,
    turned_to,
)
from slot_core.mpc.settings import PaperMpcSettings
from slot_core.mpc.solver import Solution, options, solution_of
from slot_core.robot import GRAVITY, RobotParameters

AXES = 3
FRONT = (0, 1)
SCALE = (
    1e6  # of the objective: with R = 1e-8 as it is, Clarabel stops before its tolerance
)
LEAST_VELOCITY = 1e-4  # m/s, rad/s: below it the robot stands


@dataclass(frozen=True)
class PaperStage(FirstStage):
    """Limits of the forces in one phase of the gait; the reference of the forces is zero."""

    least_normal: Array  # (4,) N
    axes: Array  # (4, 3, 3) from odom to the axes in which a leg's friction is limited
    cone: NDArray[np.bool_]  # (4,) whether that limit is a cone, else a pyramid

    def clip(self, force: Array) -> Array:
        """Forces (4, 3) N clipped to the limits, the normal forces first."""
        local = (self.axes * force[:, None]).sum(axis=-1)
        local[:, 2] = np.clip(local[:, 2], self.least_normal, self.force_max)
        limit = self.friction * local[:, 2]
        length = norm(local[:, :2])
        share = np.where(
            self.cone, np.minimum(1.0, limit / np.maximum(length, 1e-12)), 1.0
        )
        local[:, :2] = np.clip(
            share[:, None] * local[:, :2], -limit[:, None], limit[:, None]
        )
        return (self.axes * local[:, :, None]).sum(axis=1)

    def slacks(self, force: Array) -> Array:
        """Slacks (3, 4) N of forces (4, 3) N: least and largest normal force, friction."""
        x, y, normal = (self.axes * force[:, None]).sum(axis=-1).T
        tangential = np.where(self.cone, hypot(x, y), np.maximum(np.abs(x), np.abs(y)))
        limits = self.force_max - normal, self.friction * normal - tangential
        return np.stack([normal - self.least_normal, *limits])


@dataclass(frozen=True)
class _Phase:
    """Constant arrays of the problem in one phase of the gait; rows s = d - C z."""

    stage: PaperStage
    hessian: sparse.csc_matrix  # (n, n) of z = [u_0, x_1, u_1, x_2, ...]
    force_slope: Array  # (12,) linear cost of a stage's forces
    balance: Array  # rows (e, 12) of a stage's forces with s = 0: sum f_z
    rows: Array  # (m, 12) s >= 0
    bound: Array  # (m,) their d
    cones: Array  # (3 c, 12) s in the second-order cone, d = 0


class PaperProblem:
    """The problem with the values of the present tick; a second-order cone programme."""

    def __init__(self, robot: RobotParameters, settings: PaperMpcSettings):
        """Set up the phases: FL pulled, FR pulled, none."""
        self._settings, self._terms = settings, settings.terms
        self.horizon, self.mass = settings.horizon, settings.terms.mass
        outward = np.sign(robot.clamps) * [1.0, 1.0, 0.0] + [0.0, 0.0, -1.0]
        self._levers = robot.clamps + outward * self._terms.lever
        self._inertia = robot.torso.inertia * self.mass / robot.torso.mass
        self._axes = (
            _leg_axes(robot)
            if self._terms.leg_axes
            else np.tile(np.eye(AXES), (FEET, 1, 1))
        )
        self._phases = {pulled: self._phase(pulled) for pulled in (*FRONT, None)}
        self._reference = np.zeros((self.horizon, STATES))
        self._now = self._phases[None]

    def read(self, preview: GaitPreview) -> PaperStage:
        """Take phase and references of a preview; returns the limits of the forces."""
        self._now = self._phases[pulled_leg(preview)]
        self._reference = np.asarray(preview.reference, dtype=float)[: self.horizon]
        return replace(self._now.stage, rate=preview.rate)

    def update(self, state: Array, preview: GaitPreview) -> None:
        """Set the present state (12,), at stage 0 of the preview that was read."""
        yaw = float(state[2]) if self._terms.turning else 0.0
        self._set(state, self._reference, self.predict(preview.dt, yaw))

    def set(
        self, state: Array, reference: Array, pulled: int | None, dt: float
    ) -> None:
        """Set state (12,), its reference (12,) over the horizon, and the pulled front leg."""
        self._now = self._phases[pulled]
        self._set(state, np.tile(reference, (self.horizon, 1)), self.predict(dt))

    def predict(self, dt: float, yaw: float = 0.0) -> Prediction:
        """Model of a stage of dt (s) at a yaw (rad), by explicit Euler."""
        turn = rotation_z(yaw)
        a, b, drift = np.eye(STATES), np.zeros((STATES, INPUTS)), np.zeros(STATES)
        a[:3, 6:9], a[3:6, 9:] = dt * turn.T, dt * np.eye(AXES)
        a[9:, 9:] -= dt * np.diag(self._terms.drag)
        inertia = product(product(turn, self._inertia), turn.T)
        arms = lever_arms(product(self._levers, turn.T))
        b[6:9] = dt * product(inverse(inertia), arms)
        b[9:] = dt / self.mass * np.tile(np.eye(AXES), FEET)
        drift[-1] = -dt * GRAVITY
        return Prediction(a, b, drift)

    def solve(self) -> Solution:
        """Solve the problem with its present values; raises nothing."""
        settings = options(self._settings.solver)
        objective = (
            SCALE * sparse.triu(self._now.hessian, format="csc"),
            SCALE * self._slope,
        )
        parts = *objective, self._matrix, self._right, self._cones, settings
        return solution_of(clarabel.DefaultSolver(*parts))

    def balance(self, force: Array) -> float:
        """Slack of the balance of forces (4, 3) N with the weight, N."""
        return self._terms.balance_band - abs(
            float(force[:, 2].sum()) - self.mass * GRAVITY
        )

    def forces(self, z: Array) -> Array:
        """Forces (H, 4, 3) N at z."""
        return z.reshape(self.horizon, STAGE)[:, :INPUTS].reshape(-1, FEET, AXES).copy()

    def cost(self, z: Array) -> float:
        """Objective at z, the present state's error included."""
        return (
            float((z * (sparse_product(self._now.hessian, z) / 2 + self._slope)).sum())
            + self._constant
        )

    def violation(self, z: Array) -> float:
        """Largest violation of a limit of the forces, N."""
        slack = self._right - sparse_product(self._matrix, z)
        dynamics, now = self.horizon * STATES, self._now
        equal, above, cones = np.split(
            slack[dynamics:],
            np.cumsum([self.horizon * len(p) for p in (now.balance, now.rows)]),
        )
        sides = cones.reshape(-1, AXES)
        outside = norm(sides[:, 1:]) - sides[:, 0]
        return float(max(0.0, *np.abs(equal), *-above, *outside))

    def residual(self, z: Array) -> float:
        """Largest error of the dynamics over the stages, SI units."""
        return float(
            np.abs(sparse_product(self._matrix, z) - self._right)[
                : self.horizon * STATES
            ].max()
        )

    def _set(self, state: Array, reference: Array, model: Prediction) -> None:
        """Set matrix, right side and linear cost for a state and references (H, 12)."""
        now, size, stages = self._now, self.horizon, sparse.eye(self.horizon)
        here = np.hstack([-model.b, np.eye(STATES)])
        before = np.hstack([np.zeros((STATES, INPUTS)), -model.a])
        parts = [
            sparse.kron(stages, here) + sparse.kron(sparse.eye(size, k=-1), before)
        ]
        for rows in (now.balance, now.rows, now.cones):
            wide = np.hstack([rows, np.zeros((len(rows), STATES))])
            parts.append(sparse.kron(stages, wide))
        self._matrix = sparse.csc_matrix(sparse.vstack(parts))
        dynamics = np.tile(model.drift, size)
        dynamics[:STATES] += product(model.a, state)
        weight = np.full(size * len(now.balance), self.mass * GRAVITY)
        cones = np.zeros(size * len(now.cones))
        self._right = np.concatenate(
            [dynamics, weight, np.tile(now.bound, size), cones]
        )
        self._cones = [
            clarabel.ZeroConeT(len(dynamics) + len(weight)),
            clarabel.NonnegativeConeT(size * len(now.bound)),
            *[clarabel.SecondOrderConeT(AXES)] * (len(cones) // AXES),
        ]
        target, q = turned_to(reference, state), self._settings.weights.q
        slope = np.zeros((size, STAGE))
        slope[:, :INPUTS] = now.force_slope
        slope[:-1, INPUTS:] = -2.0 * q * target[1:]
        self._slope = slope.ravel()
        error = state - target[0]
        pull = (
            self._terms.pull_weight
            * self._terms.pull
            * self._terms.pull
            * bool(now.force_slope.any())
        )
        self._constant = (
            float((error * (q * error)).sum() + (q * np.square(target[1:])).sum())
            + size * pull
        )

    def _phase(self, pulled: int | None) -> _Phase:
        """The arrays of a phase."""
        stage, weights, terms = self._stage(pulled), self._settings.weights, self._terms
        quadratic, slope = np.diag(weights.r), np.zeros(INPUTS)
        for leg in FRONT:
            along = self._along(leg)
            quadratic += terms.pull_weight * np.outer(along, along)
            slope -= 2.0 * terms.pull_weight * terms.pull * along * (leg == pulled)
        last = np.append(np.ones(self.horizon - 1), 0.0)
        blocks = [m for k in last for m in (quadratic, np.diag(k * weights.q))]
        hessian = sparse.csc_matrix(2.0 * sparse.block_diag(blocks))
        balance, rows, bound, cones = self._limits(stage, pulled)
        return _Phase(stage, hessian, slope, balance, rows, bound, cones)

    def _stage(self, pulled: int | None) -> PaperStage:
        """Limits of the forces with a front leg pulled."""
        terms, legs, none = self._terms, np.arange(FEET), np.zeros(FEET)
        of_pulled, of_released, of_rear = terms.friction
        front = np.where(legs == pulled, of_pulled, of_released)
        return PaperStage(
            force_max=np.full(FEET, self._settings.force_max),
            friction=np.where(legs > max(FRONT), of_rear, front),
            force_ref=np.zeros((FEET, AXES)),
            rate=none,
            least_normal=np.where(legs == pulled, 0.0, terms.least_normal),
            axes=self._axes,
            cone=(legs > max(FRONT)) & terms.leg_axes,
        )

    def _along(self, leg: int, axis: int = 0) -> Array:
        """Row (12,) of a leg's force along one of its axes."""
        row = np.zeros(INPUTS)
        row[AXES * leg : AXES * leg + AXES] = self._axes[leg][axis]
        return row

    def _limits(
        self, stage: PaperStage, pulled: int | None
    ) -> tuple[Array, Array, Array, Array]:
        """Rows of the balance, of other limits with their bounds, and of the cones."""
        terms, rows, bound, cones = (
            self._terms,
            list[Array](),
            list[float](),
            list[Array](),
        )
        total = np.tile([0.0, 0.0, 1.0], FEET)
        weight, band = self.mass * GRAVITY, terms.balance_band
        for sign in (1.0, -1.0) if band else ():
            rows.append(sign * total)
            bound.append(band + sign * weight)
        for leg in range(FEET):
            x, y, z = (self._along(leg, axis) for axis in range(AXES))
            rows += [-z, z]
            bound += [-stage.least_normal[leg], stage.force_max[leg]]
            limit = stage.friction[leg] * z
            if stage.cone[leg]:
                cones += [-limit, -x, -y]
            else:
                rows += [side - limit for side in (x, -x, y, -y)]
                bound += [0.0] * 4
            if leg == pulled and terms.pull_weight:
                rows.append(-x)
                bound.append(-terms.least_pull)
        balance = np.zeros((0, INPUTS)) if band else total[None]
        return (
            balance,
            np.array(rows),
            np.array(bound),
            np.array(cones).reshape(-1, INPUTS),
        )


def pulled_leg(preview: GaitPreview) -> int | None:
    """The front leg that is pulled at the present phase; None where the robot is to stand."""
    if not np.abs(preview.velocity_ahead[0]).max() > LEAST_VELOCITY:
        return None
    return FRONT[int(preview.phase >= 0.5)]


def _leg_axes(robot: RobotParameters) -> Array:
    """(4, 3, 3) from odom to the legs' axes of the authors' scripts: x at minus the azimuth."""
    s, c, flat = sin(robot.azimuth), cos(robot.azimuth), np.zeros(FEET)
    axes = np.array([[c, -s, flat], [s, c, flat], [flat, flat, flat + 1.0]])
    return np.moveaxis(axes, -1, 0)
