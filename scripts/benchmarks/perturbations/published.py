"""The paper's perturbations as published: the published problem on its own linear model.

    minimise    sum_k=0^14 (x_k - x_ref)' Q (x_k - x_ref) + 1e-8 u_k'u_k + 0.01 (f_x,l - a_l)^2
    subject to  x_k+1 = x_k + dt (A x_k + B u_k - g e_vz)        explicit Euler
                |sum f_z - m g| <= 0.01 N, 0 <= f_z <= 6 N, f_z >= 4 N but for the pulled front leg
                the front legs' |f_x|, |f_y| <= mu f_z, the rear legs' |(f_x, f_y)| <= mu f_z

with the tangential forces in the legs' frames. The last term of the cost is over the front legs
only: a = 0.6 N and f_x >= 0.2 N for the pulled leg, a = 0 for the other. The front legs change
roles every 2.5 s; friction is 0.6 for the pulled leg, 0.2 for the released one and 0.1 at the rear.
A has drag, -0.1 on v_x and v_y and -0.5 on v_z. Fifteen steps solve and apply u_0, five hold it.
Over the first three steps every applied f_z is at least m g / 4 + 0.2 N.

Problem, model and the raised forces are those of the authors' published walk; references, initial
states and cycles are the paper's. The authors' script for the table itself is not available. The
5 ms lag of their actuators is left out. They solve with SCS at its default accuracy; here Clarabel
computes the optimum.
"""

from __future__ import annotations

from collections.abc import Mapping

import clarabel
import numpy as np
from scipy import sparse

from benchmarks.perturbations.cases import DT, HEIGHT, NOISE, P_Z, SPEED, V_X, PerturbedRun
from slot_core.mpc.model import FEET, INPUTS, STATES
from slot_core.mpc.settings import MpcSettings
from slot_core.robot import GRAVITY, Array, RobotParameters

MASS = 2.16  # kg, torso and legs of 0.04 kg
FOOT_OFFSET = 0.19 * np.sqrt(2.0)  # m from the corner along each axis: twice the leg's length
FOOT_DROP = 0.177  # m
DRAG = (0.1, 0.1, 0.5)  # 1/s
GAIT_PERIOD = 5.0  # s
FRICTION = {"pulled": 0.6, "released": 0.2, "rear": 0.1}
LEAST_NORMAL, LEAST_PULL, PULL, PULL_WEIGHT = 4.0, 0.2, 0.6, 0.01  # N, N, N, 1/N^2
RAISED_FORCE, RAISED_STEPS = 0.2, 3  # N per leg beyond m g / 4, in the first steps
SOLVED_STEPS, HELD_STEPS = 15, 5
MOST_STATE = 1.0  # SI, limit of states with noise; the authors' limit is unknown
TOLERANCE = 1e-9
AXES = 3


class PublishedProblem:
    """The published second-order cone programme in one phase; z = [u_0, x_1, u_1, x_2, ...]."""

    def __init__(self, robot: RobotParameters, settings: MpcSettings, phase: int):
        """`phase` is the front leg that is pulled, 0 or 1."""
        self._settings, self.horizon = settings, settings.horizon
        self.a, self.b, self.drift = published_model(robot)
        self.target = np.zeros(STATES)
        self.target[[P_Z, V_X]] = HEIGHT, SPEED
        s, c, flat = np.sin(robot.azimuth), np.cos(robot.azimuth), np.zeros(FEET)
        # (4, 3, 3) odom to the legs' frames of the authors' scripts: x at minus the azimuth
        frames = np.array([[c, -s, flat], [s, c, flat], [flat, flat, flat + 1.0]])
        self._turns = np.moveaxis(frames, -1, 0)
        self._cost(phase)
        self._constrain(phase)

    def solve(self, state: Array) -> tuple[Array, float, bool]:
        """First forces (4, 3), N, the cost, and whether it is solved, for a state (12,)."""
        b = self._b.copy()
        b[:STATES] += self.a @ state
        cones, options = self._cones, clarabel.DefaultSettings()
        options.verbose = False
        options.tol_gap_abs = options.tol_gap_rel = options.tol_feas = TOLERANCE
        solution = clarabel.DefaultSolver(self._p, self._c, self._rows, b, cones, options).solve()
        error = state - self.target
        constant = self._constant + float(error @ (self._settings.weights.q * error))
        solved = str(solution.status) in {"Solved", "AlmostSolved"}
        force = np.array(solution.x)[:INPUTS].reshape(FEET, AXES)
        return force, float(solution.obj_val) + constant, solved

    def _cost(self, phase: int) -> None:
        """Set 1/2 z'Pz + c'z + constant; the last state of the horizon has no cost."""
        weights, size = self._settings.weights, self.horizon
        quadratic, linear = np.diag(weights.r), np.zeros(INPUTS)
        for leg in (0, 1):
            row = np.zeros(INPUTS)
            row[AXES * leg : AXES * leg + AXES] = self._turns[leg][0]
            pull = PULL if leg == phase else 0.0
            quadratic += PULL_WEIGHT * np.outer(row, row)
            linear -= PULL_WEIGHT * pull * row
        last = np.append(np.ones(size - 1), 0.0)
        blocks = [m for k in last for m in (quadratic, np.diag(k * weights.q))]
        self._p = sparse.csc_matrix(sparse.triu(2.0 * sparse.block_diag(blocks)))
        rows = [np.concatenate([linear, -k * weights.q * self.target]) for k in last]
        self._c = 2.0 * np.concatenate(rows)
        distance = float(self.target @ (weights.q * self.target))
        self._constant = size * PULL_WEIGHT * PULL**2 + (size - 1) * distance

    def _constrain(self, phase: int) -> None:
        """Set Clarabel's form: b - A z in zero, non-negative and second-order cones."""
        linear, cones, bound = self._stage_limits(phase)
        size, stages = self.horizon, sparse.eye(self.horizon)
        wide = np.hstack([linear, np.zeros((len(linear), STATES))])
        cone = np.hstack([cones, np.zeros((len(cones), STATES))])
        here = np.hstack([-self.b, np.eye(STATES)])
        before = np.hstack([np.zeros((STATES, INPUTS)), -self.a])
        dynamics = sparse.kron(stages, here) + sparse.kron(sparse.eye(size, k=-1), before)
        parts = [dynamics, sparse.kron(stages, wide), sparse.kron(stages, cone)]
        self._rows = sparse.csc_matrix(sparse.vstack(parts))
        most = [np.tile(self.drift, size), np.tile(bound, size), np.zeros(size * len(cone))]
        self._b = np.concatenate(most)
        self._cones = [
            clarabel.ZeroConeT(size * STATES),
            clarabel.NonnegativeConeT(size * len(linear)),
            *[clarabel.SecondOrderConeT(AXES)] * (size * len(cone) // AXES),
        ]

    def _stage_limits(self, phase: int) -> tuple[Array, Array, Array]:
        """A stage's linear rows (m, 12) and cone rows (6, 12) over its inputs; bounds (m,)."""
        rows, bound, cones = list[Array](), list[float](), list[Array]()

        def at_most(row: Array, most: float) -> None:
            rows.append(row)
            bound.append(most)

        normal = np.zeros((FEET, INPUTS))
        for leg in range(FEET):
            place = slice(AXES * leg, AXES * leg + AXES)
            along, across = np.zeros((2, INPUTS))
            along[place], across[place] = self._turns[leg][:2]
            normal[leg, AXES * leg + 2] = 1.0
            at_most(-normal[leg], 0.0 if leg == phase else -LEAST_NORMAL)
            at_most(normal[leg], self._settings.force_max)
            grip = "rear" if leg > 1 else "pulled" if leg == phase else "released"
            limit = FRICTION[grip] * normal[leg]
            if leg in (0, 1):
                for row in (along, -along, across, -across):
                    at_most(row - limit, 0.0)
            else:
                cones += [-limit, -along, -across]
            if leg == phase:
                at_most(-along, -LEAST_PULL)
        band = self._settings.model.support_band
        at_most(normal.sum(axis=0), MASS * GRAVITY + band)
        at_most(-normal.sum(axis=0), band - MASS * GRAVITY)
        return np.array(rows), np.array(cones), np.array(bound)


def published_model(robot: RobotParameters) -> tuple[Array, Array, Array]:
    """(a, b, drift) of x_k+1 = a x_k + b u_k + drift: a box with the robot's mass, feet far out."""
    a, b = np.zeros((STATES, STATES)), np.zeros((STATES, INPUTS))
    a[:6, 6:] = np.eye(6)
    a[9:, 9:] = -np.diag(DRAG)
    inertia = robot.torso.inertia * MASS / robot.torso.mass
    for leg, clamp in enumerate(robot.clamps):
        x, y, z = clamp + np.append(np.sign(clamp[:2]) * FOOT_OFFSET, -FOOT_DROP)
        lever = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        b[6:9, AXES * leg : AXES * leg + AXES] = np.linalg.solve(inertia, lever)
        b[9:, AXES * leg : AXES * leg + AXES] = np.eye(AXES) / MASS
    drift = np.zeros(STATES)
    drift[-1] = -DT * GRAVITY
    return np.eye(STATES) + DT * a, DT * b, drift


def run_published(
    robot: RobotParameters,
    settings: MpcSettings,
    change: Mapping[int, float],
    duration: float,
    noise: np.random.Generator | None = None,
) -> PerturbedRun:
    """Run a case over whole cycles of 15 solved and 5 held steps; `noise` is added to the state."""
    problems = [PublishedProblem(robot, settings, phase) for phase in (0, 1)]
    state, entries, infeasible = np.zeros(STATES), [], 0
    for place, value in change.items():
        state[place] = value
    cycle = SOLVED_STEPS + HELD_STEPS
    force = np.zeros((FEET, AXES))
    for step in range(int(duration / (cycle * DT)) * cycle):
        time = step * DT
        if step % cycle < SOLVED_STEPS:
            problem = problems[int(time % GAIT_PERIOD >= GAIT_PERIOD / 2)]
            force, cost, solved = problem.solve(state)
            infeasible += not solved
            entries.append((time, cost, state))
        if step < RAISED_STEPS:
            force[:, 2] = np.maximum(force[:, 2], MASS * GRAVITY / FEET + RAISED_FORCE)
        state = problem.a @ state + problem.b @ force.ravel() + problem.drift
        if noise is not None:
            state = np.clip(state + NOISE * noise.normal(size=STATES), -MOST_STATE, MOST_STATE)
    return PerturbedRun.of(*zip(*entries), infeasible)
