"""The MPC's problem, section V-B, as printed (`paper_text`) and as published (`paper_code`).

    minimise    sum_k=0^H-1 (x_k - x_ref,k)' Q (x_k - x_ref,k) + u_k' R u_k
                + sum of the front legs w (f_x - a)^2
    subject to  x_k+1 = x_k + dt (A x_k + B u_k - g e_vz)
                |sum f_z - m g| <= band,  least <= f_z <= f_max
                |f_x|, |f_y| <= mu f_z,   of the rear legs of paper_code |(f_x, f_y)| <= mu f_z

A has the drag of the velocity, B the levers r_i of the forces: in print those of the attachments,
turned with the present yaw as the inertia; in the scripts of feet twice a leg's length away, not
turned. The torso is a box of the robot's mass. The last input drives a state without cost.

The front legs take turns (`gaits`): mu is that of a pulled, a released or a rear leg, all at the
present phase of the gait, for all stages. paper_code limits and weighs the forces in the legs'
axes: the pulled leg has a = pull and f_x >= least_pull, the released one a = 0, and all but the
pulled one f_z >= least_normal. No leg is lifted: three legs of f_max = 6 N do not carry the weight.
The gait gives the references; those of the scripts are 0.02 m/s and 0.1 m.

The print leaves the discretisation open; explicit Euler and the mass of the whole robot are the
scripts'. Numbers: `config/mpc/paper_text.yaml`, `config/mpc/paper_code.yaml`.
"""

from dataclasses import dataclass, replace

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import flag, quantity, text
from slot_core.control.policy import Status, TendonPlan
from slot_core.elementary import cos, hypot, sin
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitPreview, Vector3
from slot_core.geometry import matrix_of_rpy
from slot_core.key_frame import StateParts
from slot_core.matrices import inverse, norm, product, sparse_product
from slot_core.mpc.force_mpc import ForceMpc
from slot_core.mpc.force_problem import Solution, options, solution_of
from slot_core.mpc.model import (
    FEET,
    INPUTS,
    STAGE,
    STATES,
    FirstStage,
    Prediction,
    lever_arms,
    turned_to,
)
from slot_core.mpc.settings import MpcSettings
from slot_core.robot import GRAVITY, RobotParameters
from slot_paper.force_map import ForceAngleLine
from slot_paper.gaits import FRONT, pulled_leg

AXES = 3
SCALE = 1e6  # of the objective: with R = 1e-8 as it is, Clarabel stops before its tolerance


@dataclass(frozen=True)
class PaperTerms:
    """Terms of the paper's problem beside weights and limits."""

    mass: float = quantity(
        "mass of the box, whose weight the normal forces balance",
        "kg",
        0.1,
        100,
    )
    lever: Vector3 = quantity(
        "end of a leg's lever beyond its attachment: outward along x and y, downward",
        "m",
        0,
        1,
    )
    turning: bool = flag(
        "whether levers, inertia and rates turn with the present yaw"
    )
    drag: Vector3 = quantity("drag of the velocity", "1/s", 0, 10)
    balance_band: float = quantity(
        "largest imbalance of the normal forces", "N", 0, 100
    )
    friction: Vector3 = quantity(
        "friction of the pulled front leg, the released one, and the rear legs",
        "",
        0,
        2,
    )
    leg_axes: bool = flag(
        "whether friction is limited in the legs' axes, at the rear by a cone"
    )
    least_normal: float = quantity(
        "least normal force of all legs but the pulled one", "N", 0, 100
    )
    least_pull: float = quantity(
        "least force of the pulled leg along its axis", "N", 0, 10
    )
    pull: float = quantity("target of that force", "N", 0, 10)
    pull_weight: float = quantity(
        "weight of the front legs' forces along their axes; 0: without least_pull too",
        "1/N^2",
        0,
        1,
    )


@dataclass(frozen=True)
class PaperMpcSettings(MpcSettings):
    """Settings of a policy of the paper."""

    terms: PaperTerms = text("terms of its problem")
    line: ForceAngleLine = text("its force map")


def read_paper_mpc(policy: str) -> PaperMpcSettings:
    """The settings of a policy of the paper; raises ConfigError.

    `config/mpc/<policy>.yaml` holds the terms of its problem, its force map and, by dotted name,
    what differs from `config/mpc.yaml`.
    """
    profile, where = config.load(f"mpc/{policy}"), f"mpc/{policy}.yaml"
    changes = dict(profile) if isinstance(profile, dict) else {}
    own = {name: changes.pop(name, None) for name in ("terms", "line")}
    config.read(MpcSettings, "mpc")  # refused under its own name
    settings = config.build(
        PaperMpcSettings, {**config.load("mpc"), **own}, where
    )
    return config.replace(settings, changes, where)


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
        length = np.maximum(norm(local[:, :2]), 1e-12)
        share = np.where(self.cone, np.minimum(1.0, limit / length), 1.0)
        scaled = share[:, None] * local[:, :2]
        local[:, :2] = np.clip(scaled, -limit[:, None], limit[:, None])
        return (self.axes * local[:, :, None]).sum(axis=1)

    def slacks(self, force: Array) -> Array:
        """Slacks (3, 4) N of forces (4, 3) N: least and largest normal force, friction."""
        x, y, normal = (self.axes * force[:, None]).sum(axis=-1).T
        tangential = np.where(
            self.cone, hypot(x, y), np.maximum(np.abs(x), np.abs(y))
        )
        limits = self.force_max - normal, self.friction * normal - tangential
        return np.stack([normal - self.least_normal, *limits])


@dataclass(frozen=True)
class _Phase:
    """Constant arrays of the problem in one phase of the gait, over the horizon.

    The slack d - C z of the limits is zero in the first rows, at least zero in the next, and in a
    second-order cone for every three of the last.
    """

    stage: PaperStage
    hessian: sparse.csc_matrix  # (n, n) of z = [u_0, x_1, u_1, x_2, ...]
    force_slope: Array  # (12,) linear cost of a stage's forces
    constant: float  # cost at zero forces
    limits: sparse.csc_matrix  # C
    right: Array  # d
    rows: tuple[int, int, int]  # of each kind


class PaperProblem:
    """The problem with the values of the present tick; a second-order cone programme."""

    def __init__(self, robot: RobotParameters, settings: PaperMpcSettings):
        """Set up the phases: FL pulled, FR pulled, none."""
        self._settings, self._terms = settings, settings.terms
        self.horizon, self.mass = settings.horizon, settings.terms.mass
        outward = np.sign(robot.clamps) * [1.0, 1.0, 0.0] + [0.0, 0.0, -1.0]
        self._levers = robot.clamps + outward * self._terms.lever
        self._inertia = robot.torso.inertia * self.mass / robot.torso.mass
        self._axes = np.tile(np.eye(AXES), (FEET, 1, 1))
        if self._terms.leg_axes:
            self._axes = _leg_axes(robot)
        self._phases = {
            pulled: self._phase(pulled) for pulled in (*FRONT, None)
        }
        self._reference = np.zeros((self.horizon, STATES))
        self._now = self._phases[None]

    def read(self, preview: GaitPreview) -> PaperStage:
        """Take phase and references of a preview; returns the limits of the forces."""
        self._now = self._phases[pulled_leg(preview)]
        self._reference = np.asarray(preview.reference, dtype=float)[
            : self.horizon
        ]
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
        self._set(
            state, np.tile(reference, (self.horizon, 1)), self.predict(dt)
        )

    def predict(self, dt: float, yaw: float = 0.0) -> Prediction:
        """Model of a stage of dt (s) at a yaw (rad), by explicit Euler."""
        turn = matrix_of_rpy([0.0, 0.0, yaw])
        a, b, drift = (
            np.eye(STATES),
            np.zeros((STATES, INPUTS)),
            np.zeros(STATES),
        )
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
        equal, above, cones = self._now.rows
        upper = sparse.triu(self._now.hessian, format="csc")
        solver = clarabel.DefaultSolver(
            SCALE * upper,
            SCALE * self._slope,
            sparse.vstack([self._dynamics, self._now.limits], format="csc"),
            np.concatenate([self._drift, self._now.right]),
            [
                clarabel.ZeroConeT(len(self._drift) + equal),
                clarabel.NonnegativeConeT(above),
                *[clarabel.SecondOrderConeT(AXES)] * (cones // AXES),
            ],
            options(self._settings.solver),
        )
        return solution_of(solver)

    def balance(self, force: Array) -> float:
        """Slack of the balance of forces (4, 3) N with the weight, N."""
        imbalance = float(force[:, 2].sum()) - self.mass * GRAVITY
        return self._terms.balance_band - abs(imbalance)

    def forces(self, z: Array) -> Array:
        """Forces (H, 4, 3) N at z."""
        return (
            z.reshape(self.horizon, STAGE)[:, :INPUTS]
            .reshape(-1, FEET, AXES)
            .copy()
        )

    def cost(self, z: Array) -> float:
        """Objective at z, the present state's error included."""
        gradient = sparse_product(self._now.hessian, z) / 2 + self._slope
        return float((z * gradient).sum()) + self._constant

    def violation(self, z: Array) -> float:
        """Largest violation of a limit of the forces, N."""
        slack = self._now.right - sparse_product(self._now.limits, z)
        equal, above, cones = np.split(slack, np.cumsum(self._now.rows)[:2])
        sides = cones.reshape(-1, AXES)
        outside = norm(sides[:, 1:]) - sides[:, 0]
        return float(max(0.0, *np.abs(equal), *-above, *outside))

    def residual(self, z: Array) -> float:
        """Largest error of the dynamics over the stages, SI units."""
        return float(
            np.abs(sparse_product(self._dynamics, z) - self._drift).max()
        )

    def _set(self, state: Array, reference: Array, model: Prediction) -> None:
        """Set dynamics and linear cost for a state and references (H, 12)."""
        size, now = self.horizon, self._now
        here = np.hstack([-model.b, np.eye(STATES)])
        before = np.hstack([np.zeros((STATES, INPUTS)), -model.a])
        self._dynamics = sparse.csc_matrix(
            sparse.kron(sparse.eye(size), here)
            + sparse.kron(sparse.eye(size, k=-1), before)
        )
        self._drift = np.tile(model.drift, size)
        self._drift[:STATES] += product(model.a, state)
        target, q = turned_to(reference, state), self._settings.weights.q
        slope = np.zeros((size, STAGE))
        slope[:, :INPUTS] = now.force_slope
        slope[:-1, INPUTS:] = -2.0 * q * target[1:]
        self._slope = slope.ravel()
        error = state - target[0]
        now_and_later = (error * (q * error)).sum() + (
            q * np.square(target[1:])
        ).sum()
        self._constant = float(now_and_later) + now.constant

    def _phase(self, pulled: int | None) -> _Phase:
        """The arrays of a phase."""
        stage, weights, terms = (
            self._stage(pulled),
            self._settings.weights,
            self._terms,
        )
        quadratic, slope = np.diag(weights.r), np.zeros(INPUTS)
        for leg in FRONT:
            along = self._along(leg)
            quadratic += terms.pull_weight * np.outer(along, along)
            slope -= (
                2.0 * terms.pull_weight * terms.pull * along * (leg == pulled)
            )
        size = self.horizon
        last = np.append(np.ones(size - 1), 0.0)
        blocks = [m for k in last for m in (quadratic, np.diag(k * weights.q))]
        hessian = sparse.csc_matrix(2.0 * sparse.block_diag(blocks))
        missed = size * terms.pull_weight * terms.pull * terms.pull
        balance, above, bound, cones = self._limits(stage, pulled)
        wide = [
            np.pad(rows, ((0, 0), (0, STATES)))
            for rows in (balance, above, cones)
        ]
        limits = sparse.vstack(
            [sparse.kron(sparse.eye(size), rows) for rows in wide]
        )
        weight = np.full(size * len(balance), self.mass * GRAVITY)
        return _Phase(
            stage=stage,
            hessian=hessian,
            force_slope=slope,
            constant=missed if slope.any() else 0.0,
            limits=sparse.csc_matrix(limits),
            right=np.concatenate(
                [weight, np.tile(bound, size), np.zeros(size * len(cones))]
            ),
            rows=(size * len(balance), size * len(above), size * len(cones)),
        )

    def _stage(self, pulled: int | None) -> PaperStage:
        """Limits of the forces with a front leg pulled."""
        terms, legs = self._terms, np.arange(FEET)
        of_pulled, of_released, of_rear = terms.friction
        front = np.where(legs == pulled, of_pulled, of_released)
        return PaperStage(
            force_max=np.full(FEET, self._settings.force_max),
            friction=np.where(legs > max(FRONT), of_rear, front),
            force_ref=np.zeros((FEET, AXES)),
            rate=np.zeros(FEET),
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
        """Rows (n, 12) of a stage's forces: balance, other limits, their bounds, cones."""
        terms, weight = self._terms, self.mass * GRAVITY
        rows, bound, cones = list[Array](), list[float](), list[Array]()
        balance = np.tile([0.0, 0.0, 1.0], FEET)[None]
        if terms.balance_band:
            rows += [*balance, *-balance]
            bound += [terms.balance_band + weight, terms.balance_band - weight]
            balance = balance[:0]
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
        above = np.array(rows)
        return balance, above, np.array(bound), np.reshape(cones, (-1, INPUTS))


class PaperMpc(ForceMpc):
    """The paper's controller: its problem, and the tendon angles of its force map."""

    STATE = StateParts(*ForceMpc.STATE.names, values=(FirstStage, PaperStage))
    _settings: PaperMpcSettings

    @staticmethod
    def read_settings(name: str) -> PaperMpcSettings:
        """The settings of `paper_text` or `paper_code`; raises ConfigError."""
        return read_paper_mpc(name)

    def make_problem(self) -> PaperProblem:
        """The paper's problem."""
        return PaperProblem(self._robot, self._settings)

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """Plan for the estimate at stage 0 of `preview`; the driver holds the angles."""
        plan = super().step(estimate, preview)
        normal = plan.force[..., 2]
        if plan.status is Status.STOPPED:
            normal = normal[:0]
        angle = self._settings.line.angle(normal)
        return replace(plan, angle=angle, rate=np.zeros(FEET), map="")


def _leg_axes(robot: RobotParameters) -> Array:
    """(4, 3, 3) from odom to the legs' axes of the authors' scripts: x at minus the azimuth."""
    s, c, flat = sin(robot.azimuth), cos(robot.azimuth), np.zeros(FEET)
    axes = np.array([[c, -s, flat], [s, c, flat], [flat, flat, flat + 1.0]])
    return np.moveaxis(axes, -1, 0)
