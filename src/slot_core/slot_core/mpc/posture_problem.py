"""Problem of the MPC on tendon angles: the posture of a torso on legs that act as springs.

Posture q = [z, roll, pitch]; tendon angle a and commanded angle u (4,) as deviations from the
gait's. A leg with its clamp at (X, Y) in base_link is the spring f = F(theta, h) of
`leg_springs.py`, so that at rest with contacts at (X_c, Y_c)

    sum [1, Y_c, -X_c]' f_i - [m g, 0, 0]' + d = 0,        h_i = z + Y roll - X pitch.

Linearised about the gait's angles and the reference posture, A (q - q_ref) + B a + e + d = 0, with
A = sum of levers F_h dh/dq, negative definite, and e the error of balance at the reference. The
feet slide on the floor, which damps the torso; its motion over the horizon is taken as

    q' = (-(q - q_ref) - A^-1 (B a + e + d)) / settling,        a' = (u - a) / lag,

discretised by the trapezoidal rule. Over the stages k = 0 .. H-1 the MPC minimises

    sum 1/2 q_k+1' Q q_k+1 + 1/2 (u_k - u_b)' R (u_k - u_b) + 1/2 (u_k - u_k-1)' S (u_k - u_k-1)
        + w (s_k + 1/2 s_k^2)

about the references, with u_b the least deviations that balance e + d at q_ref, subject to

    0 <= theta <= theta_max,   |u| <= correction_max,   f_i >= -s_k,   s_k >= 0.

The slack s_k keeps the problem feasible from every state. The disturbance d (3,) is observed: what
is missing from the balance at the measured posture q and rate q', low-pass filtered with the time
constants T_d of height and tilt,

    T_d d' = -(A (q - q_ref + motion T_d q') + B a + e) - d.

It removes the steady error by payload, slope or wrong stiffness. The balance is the linear one of
the prediction, so that a posture at its reference is at rest. A moving torso is out of balance by
the friction of its feet, which would count as a disturbance without the term of q'.

Friction. A foot that sticks makes the leg stiff and, for small changes of the angle, even reverses
its effect: winding the tendon first pulls the torso down. So

- errors within a tolerance are ignored: the problem's posture is the measured one, moved towards
  the reference by at most the tolerance;
- beyond, a dither on the angles makes the feet slide: +-amplitude from tick to tick, opposite in
  sign on the two diagonals, which does not move the torso. It decays when the error is gone.

The problem is solved for postures (`GaitPreview.posture`), whose legs are at rest. For a gait the
forces are the gait's own, u = 0; steady errors are the stride feedback's (`stride_feedback.py`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import piqp

from slot_core.clock import to_seconds
from slot_core.config import quantity
from slot_core.control.policy import TendonPlan
from slot_core.gait.gait import GaitPreview
from slot_core.legs.leg_springs import LegSprings
from slot_core.mpc.model import FEET, FirstStage, Horizon
from slot_core.mpc.piqp_solver import solution
from slot_core.mpc.posture_kernels import condense, limit_forces, linearise, predict
from slot_core.mpc.solver import Solution
from slot_core.robot import GRAVITY, Array, RobotParameters

POSTURE = 3  # z, roll, pitch
SIZE = POSTURE + FEET  # state: q, a
STIFFNESS_MIN = 1.0  # N/m, of a leg in A, which is singular without; 136 in stance
LONGEST_GAP = 0.5  # s between ticks; after a longer one the model of the servos starts afresh
DIAGONALS = np.array([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class PostureOptions:
    """Weights, limits, observer and dither of the problem on tendon angles."""

    height: float = quantity("weight of an error of the height", "1/m^2", 0, 1e9)
    tilt: float = quantity("weight of errors of roll and pitch", "1/rad^2", 0, 1e9)
    angle: float = quantity(
        "weight of an angle's deviation from the one in balance", "1/rad^2", 1e-9, 1e9
    )
    change: float = quantity("weight of an angle's change from stage to stage", "1/rad^2", 0, 1e9)
    slack: float = quantity("weight of a negative normal force, 1/N and 1/N^2", "", 0, 1e9)
    correction_max_deg: float = quantity(
        "largest deviation of a tendon angle from the gait", "deg", 0, 120
    )
    settling: float = quantity("time constant of the torso on sliding feet", "s", 1e-3, 10)
    lag: float = quantity("time constant of the servo", "s", 1e-3, 1)
    height_observer: float = quantity(
        "time constant of the observer of the vertical force", "s", 0.01, 1e6
    )
    tilt_observer: float = quantity("time constant of the observer of the moments", "s", 0.01, 1e6)
    motion: float = quantity(
        "time constant of the rate feed-forward, as a share of the observer's", "", 0, 10
    )
    force_disturbance: float = quantity("largest disturbance force that is estimated", "N", 0, 100)
    moment_disturbance: float = quantity(
        "largest disturbance moment that is estimated", "N m", 0, 10
    )
    height_tolerance: float = quantity("error of the height that is ignored", "m", 1e-6, 0.1)
    tilt_tolerance: float = quantity("error of roll and pitch that is ignored", "rad", 1e-6, 1)
    dither_deg: float = quantity("largest amplitude of the dither", "deg", 0, 30)
    dither_gain_deg: float = quantity(
        "amplitude of the dither at an error of twice the tolerance", "deg", 0, 30
    )
    dither_decay: float = quantity("time constant with which the dither decays", "s", 1e-3, 10)
    tolerance: float = quantity(
        "largest absolute residual and duality gap of a solution", "", 1e-12, 1e-2
    )
    iterations: int = quantity("largest number of iterations of the solver", "", 1, 10_000)


class PostureProblem:
    """The problem with the values of the present tick, its observer, dither and solver."""

    share = 1.0  # of the robot's mass in the reference forces, which are the gait's

    def __init__(
        self, robot: RobotParameters, springs: LegSprings, options: PostureOptions, horizon: int
    ):
        """Set up weights and solver."""
        self._robot, self._springs = robot, springs
        self._options, self._horizon = options, horizon
        self._angle_max, self._weight = robot.tendon.angle_max, robot.weight
        x, y, _ = robot.clamps.T
        self._rise = np.column_stack([np.ones(FEET), y, -x])  # dh/dq of the clamps
        self._geometry = np.vstack([x, y, robot.outward[:, :2].T]), self._rise
        o, size = options, FEET * horizon
        weights = [o.height, o.tilt, o.tilt]
        self._root_weight = np.sqrt(np.tile(weights, horizon))
        step = np.eye(size) - np.eye(size, k=-FEET)
        self._input_weight = o.angle * np.eye(size) + o.change * step.T @ step
        self._solver = PostureSolver(size, horizon, options)
        self._tolerance = np.array([o.height_tolerance, o.tilt_tolerance, o.tilt_tolerance])
        m = o.moment_disturbance
        self._bound = np.array([o.force_disturbance, m, m])
        self._observer_time = np.array([o.height_observer, o.tilt_observer, o.tilt_observer])
        self.disturbance = np.zeros(POSTURE)  # N, N m
        self._spool = np.zeros(FEET)  # rad, tendon angles by the model of the servos
        self._command = np.zeros(FEET)  # rad, commanded last, without dither
        self._stamp: int | None = None  # ns, of the last tick
        self._dither, self._sign = 0.0, 1.0  # rad, amplitude; its present sign
        self._posture = False
        self._prepare(size)

    @property
    def qp(self) -> PostureSolver:
        """The quadratic programme of the last tick; read only."""
        return self._solver

    @property
    def mass(self) -> float:
        """Estimated mass, kg: the weight without the vertical force of d, over gravity."""
        return (self._weight - float(self.disturbance[0])) / GRAVITY

    def update(self, state: Array, preview: GaitPreview, ahead: Horizon) -> None:
        """Set the present state (12,), the preview and the limits and targets ahead."""
        self._posture = preview.posture
        self._nominal = np.asarray(preview.tendon_angle, dtype=float)[: self._horizon]
        self._force_ref = np.ascontiguousarray(ahead.force_ref[..., 2])
        self._contact = ahead.force_max > 0.0
        elapsed = self._follow_servos(preview.stamp)
        if not preview.posture:
            self.disturbance, self._dither = np.zeros(POSTURE), 0.0
            return
        reference = np.asarray(preview.reference)[: self._horizon][:, [5, 0, 1]]
        posture = state[[5, 0, 1]]
        error = posture - reference[0]
        inside = np.clip(error, -self._tolerance, self._tolerance)
        self._update_dither(np.abs(error - inside) / self._tolerance, elapsed)
        postures = np.vstack([reference, posture, reference[0] + error - inside])
        heights = self._robot.clamp_heights(*postures.T)
        springs = self._springs.at(self._nominal, heights[:-2])
        self._slope, self._stiffness = springs.slope, springs.stiffness
        self._legs = springs.contact, springs.slope, springs.stiffness, self._force_ref
        moved = self._options.motion * self._observer_time * state[[11, 6, 7]]
        self._observe(heights[-1] - heights[0] + self._rise @ moved, elapsed)
        self._linearise(preview.dt)
        self._reaction = self._stiffness[0] * (heights[-2] - heights[0])  # N, of the springs
        self._start = np.concatenate([error - inside, self._spool - self._nominal[0]])
        limit = math.radians(self._options.correction_max_deg)
        n = self._solver.inputs
        self._solver.low[:n] = np.maximum(-limit, -self._nominal).ravel()
        self._solver.high[:n] = np.minimum(limit, self._angle_max - self._nominal).ravel()
        self._condense()

    def solve(self) -> Solution:
        """Solve the problem with its present values; raises nothing."""
        if not self._posture:
            return Solution(np.zeros(len(self._solver.c)), "", 0)
        return self._solver.solve()

    def follow(self, plan: TendonPlan) -> None:
        """Take the plan that the legs are commanded from this tick on."""
        undithered = plan.angle[0] - self._dither_angle()
        self._command = np.clip(undithered, 0.0, self._angle_max)

    def plan(self, z: Array) -> tuple[Array, Array]:
        """Tendon angles (H, 4) rad, and forces (H, 4, 3) N that are predicted with them.

        The forces are those of legs at rest at the commanded angles, at the predicted postures. A
        leg out of contact keeps the angle of the gait.
        """
        force, angle = np.zeros((self._horizon, FEET, 3)), self._nominal.copy()
        normal = force[..., 2]
        normal[:] = self._force_ref
        if self._posture:
            u = z[: self._solver.inputs].reshape(-1, FEET).copy()
            x = self._predict(z)[:-1]
            normal += self._stiffness * (x[:, :POSTURE] @ self._rise.T)
            normal[0] = self._force_ref[0] + self._reaction  # at the measured posture
            u[0] += self._dither_angle()
            normal += self._slope * u
            angle += np.where(self._contact, u, 0.0)
        normal[:] = np.where(self._contact, np.maximum(normal, 0.0), 0.0)
        return np.clip(angle, 0.0, self._angle_max), force

    def deviation(self, stage: FirstStage, angle: Array, force: Array) -> Array:
        """First angles of a plan minus those of the gait (4,), rad."""
        return np.asarray(angle[0] - stage.angle_ref)

    def fallback(self, stage: FirstStage, deviation: Array) -> tuple[Array, Array]:
        """Angles (1, 4) rad by a deviation from the gait's, and the gait's forces (1, 4, 3) N."""
        angle = np.clip(stage.angle_ref + deviation, 0.0, self._angle_max)
        return angle[None], stage.clip(stage.force_ref)[None]

    def cost(self, z: Array) -> float:
        """Objective at z without its constant."""
        return float(0.5 * z @ self._solver.P @ z + self._solver.c @ z)

    def violation(self, z: Array) -> float:
        """Largest violation of a limit: of a force (N) or of an angle (rad); zero without one."""
        if not self._posture:
            return 0.0
        qp, n = self._solver, self._solver.inputs
        bounds = np.maximum(qp.low[:n] - z[:n], z[:n] - qp.high[:n])
        return float(max(0.0, (qp.G @ z - qp.h).max(), bounds.max()))

    def residual(self, z: Array) -> float:
        """Largest difference between the states of the condensed problem and of the model."""
        if not self._posture:
            return 0.0
        condensed = self._effect @ z[: self._solver.inputs] + self._free.ravel()
        return float(np.abs(condensed - self._predict(z)[1:].ravel()).max())

    def _prepare(self, size: int) -> None:
        """Compile the kernels and solve once, which is slow the first time."""
        count = self._horizon
        shapes = (count, SIZE, SIZE), (count, SIZE, FEET), (count, SIZE)
        self._model, self._start = tuple(np.zeros(shape) for shape in shapes), np.zeros(SIZE)
        self._predict(np.zeros(size))
        condensed = np.zeros((count, SIZE, size)), np.zeros((count, SIZE))
        condense(self._model, self._start, *condensed)
        ones = np.ones((count, FEET))
        legs = ones, ones, -ones, self._springs.at(ones, ones).force
        self._work = tuple(np.zeros((POSTURE, n)) for n in (FEET, POSTURE, FEET + 1))
        shift, rates = np.zeros((count, POSTURE, FEET + 1)), (0.5, 0.5, -STIFFNESS_MIN)
        linearise(legs, self._geometry, np.zeros(POSTURE), rates, self._work, shift, self._model)
        limit_forces(legs, self._rise, condensed, self._solver.G[:, :size], self._solver.h)
        self._solver.solve()

    def _follow_servos(self, stamp: int) -> float:
        """Advance the model of the servos to `stamp` (ns); return the time since the last, s."""
        elapsed = 0.0 if self._stamp is None else to_seconds(stamp - self._stamp)
        self._stamp = stamp
        if not 0.0 < elapsed <= LONGEST_GAP:
            self._spool = self._command = self._nominal[0].copy()
            return 0.0
        share = -math.expm1(-elapsed / self._options.lag)
        self._spool = self._spool + share * (self._command - self._spool)
        return elapsed

    def _update_dither(self, excess: Array, elapsed: float) -> None:
        """Set the amplitude from the errors beyond the tolerance, in tolerances; turn the sign."""
        o = self._options
        demand = min(o.dither_deg, o.dither_gain_deg * float(excess.max()))
        fading = self._dither * math.exp(-elapsed / o.dither_decay)
        self._dither = max(math.radians(demand), fading)
        self._sign = -self._sign

    def _dither_angle(self) -> Array:
        """Part (4,) rad of the commanded angles that is dither."""
        return (self._sign * self._dither) * DIAGONALS

    def _observe(self, raised: Array, elapsed: float) -> None:
        """Filter the wrench missing from the balance with the clamps `raised` (4,) m."""
        contact, slope, stiffness, force_ref = (part[0] for part in self._legs)
        force = force_ref + slope * (self._spool - self._nominal[0]) + stiffness * raised
        lacking = -self._levers(contact) @ np.maximum(force, 0.0)
        lacking[0] += self._weight
        share = -np.expm1(-elapsed / self._observer_time)
        filtered = self.disturbance + share * (lacking - self.disturbance)
        self.disturbance = np.clip(filtered, -self._bound, self._bound)

    def _levers(self, contact: Array) -> Array:
        """Wrench (..., 3, 4) [f_z, moments about x, y] of unit forces at contacts (..., 4) m."""
        clamps, outward = self._robot.clamps, self._robot.outward
        x = clamps[:, 0] + contact * outward[:, 0]
        y = clamps[:, 1] + contact * outward[:, 1]
        return np.stack([np.ones_like(x), y, -x], axis=-2)

    def _linearise(self, dt: float) -> None:
        """Discrete model of every stage about the gait's angles and the reference posture."""
        o, count = self._options, self._horizon
        # trapezoidal rule: x' = (target - x) / T gives x_k+1 = keep x_k + (1 - keep) mean target
        keep, held = ((2 * time - dt) / (2 * time + dt) for time in (o.settling, o.lag))
        shift = np.zeros((count, POSTURE, FEET + 1))  # of the equilibrium, by a and by e + d
        wrench = self.disturbance - [self._weight, 0.0, 0.0]
        rates = keep, held, -STIFFNESS_MIN
        linearise(self._legs, self._geometry, wrench, rates, self._work, shift, self._model)
        limit, first, rest = math.radians(o.correction_max_deg), shift[0, :, :FEET], shift[0, :, -1]
        least = -first.T @ np.linalg.solve(first @ first.T, rest)
        self._balance = np.clip(least, -limit, limit)

    def _predict(self, z: Array) -> Array:
        """States (H+1, 7) for the inputs in z."""
        states = np.zeros((self._horizon + 1, SIZE))
        predict(self._model, self._start, z[: self._solver.inputs].reshape(-1, FEET), states)
        return states

    def _condense(self) -> None:
        """Eliminate the states; set cost and limits of the inputs and slacks."""
        o, qp, count = self._options, self._solver, self._horizon
        n = qp.inputs
        effect, free = np.zeros((count, SIZE, n)), np.zeros((count, SIZE))
        condense(self._model, self._start, effect, free)
        self._effect, self._free = effect.reshape(-1, n), free
        posture = effect[:, :POSTURE].reshape(-1, n)
        weighted = self._root_weight[:, None] * posture
        qp.P[:n, :n] = weighted.T @ weighted + self._input_weight
        qp.c[:n] = weighted.T @ (self._root_weight * free[:, :POSTURE].ravel())
        qp.c[:n] -= o.angle * np.tile(self._balance, count)
        qp.c[:FEET] -= o.change * (self._command - self._nominal[0])
        limit_forces(self._legs, self._rise, (effect, free), qp.G[:, :n], qp.h)


class PostureSolver:
    """min 1/2 z'Pz + c'z with G z <= h, low <= z <= high, by PIQP; z = [u_0 .. u_H-1, s]."""

    def __init__(self, inputs: int, stages: int, options: PostureOptions):
        """Set up the solver; the arrays are changed in place before `solve`."""
        size = inputs + stages
        self.inputs, self._options = inputs, options
        self.P, self.c = np.eye(size), np.zeros(size)
        self.P[inputs:, inputs:] = options.slack * np.eye(stages)
        self.c[inputs:] = options.slack
        self.G, self.h = np.zeros((inputs, size)), np.ones(inputs)
        self.G[:, inputs:] = -np.repeat(np.eye(stages), inputs // stages, axis=0)
        self.low, self.high = np.zeros(size), np.full(size, np.inf)
        self.high[:inputs] = 1.0
        self._set_up()

    def _set_up(self) -> None:
        self._solver = piqp.DenseSolver()
        settings, o = self._solver.settings, self._options
        settings.eps_abs = settings.eps_duality_gap_abs = o.tolerance
        settings.eps_rel = settings.eps_duality_gap_rel = o.tolerance
        settings.max_iter = o.iterations
        self._solver.setup(**self._values())

    def solve(self) -> Solution:
        """Solve with the present values; raises nothing.

        Where the optimum without limits keeps all of them it is the solution: at s = 0 the weight
        of the slacks is positive. That is so in nearly every tick of a robot at rest.
        """
        n = self.inputs
        z = np.zeros(len(self.c))
        z[:n] = -np.linalg.solve(self.P[:n, :n], self.c[:n])
        inside = (self.low <= z).all() and (z <= self.high).all()
        if inside and (self.G[:, :n] @ z[:n] <= self.h).all():
            return Solution(z, "", 1)
        self._solver.update(**self._values())
        return solution(self._solver, self._set_up)

    def _values(self) -> dict[str, Array]:
        return {
            "P": self.P,
            "c": self.c,
            "G": self.G,
            "h_u": self.h,
            "x_l": self.low,
            "x_u": self.high,
        }
