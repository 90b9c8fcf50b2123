"""A rigid torso on feet fixed to the floor, whose forces lag behind their commands, under the MPC.

In odom and, for the rates, in axes fixed to the body, with R the rotation from body to odom:

    dp/dt = v                   m dv/dt = sum f_i + F - m g e_z
    dq/dt = q o (0, w) / 2      J dw/dt = R' (sum (c_i - p) x f_i + M) - w x J w
    df_i/dt = (u_i - f_i) / lag

Full rotation and gyroscopic term, no small angles. A foot c_i rests on the floor over a control
step. At each step it is placed again, where the leg will end in the torso's heading half a step
later (Raibert's rule; without it the feet would trail and tilt the torso by 20 mrad). Feet that
never moved would be left behind within two seconds at 0.08 m/s. Friction limits |f_x| and |f_y| to
mu f_z, and f_z is not negative.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.mpc.cases import standing
from benchmarks.perturbations.cases import DT, HEIGHT, NOISE, P_Z, SPEED, PerturbedRun
from slot_core import config
from slot_core.clock import to_ns
from slot_core.control.policy import Status, TendonPlan
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitCommand, GaitPreview, read_gaits
from slot_core.gait.reference import places_ahead, reference
from slot_core.geometry import rotate, rpy_of
from slot_core.mpc.mpc import Mpc
from slot_core.mpc.settings import MpcSettings
from slot_core.robot import GRAVITY, Array, RobotParameters

LAG = 0.05  # s
VELOCITY_AHEAD = np.array([SPEED, 0.0, 0.0])  # v_x, v_y m/s, yaw rate rad/s, commanded
SUBSTEPS = 8  # Runge-Kutta steps per control step: 4 ms; the samples' shortest lag is 10 ms
# Slices of the state y: quaternion x y z w, angular velocity in body axes.
POSITION, QUATERNION, VELOCITY, RATE = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)
FORCES = slice(13, 25)


@dataclass(frozen=True)
class Body:
    """True parameters of the simulated torso, which may differ from the MPC's."""

    mass: float  # kg
    inertia: Array  # (3, 3) kg m^2
    feet: Array  # (4, 3) m, base_link; the height is not used
    friction: float
    lag: float  # s


def body(robot: RobotParameters, friction: float) -> Body:
    """The robot as a rigid body."""
    return Body(robot.mass, robot.inertia, robot.feet, friction, LAG)


class RigidTorso:
    """The body on its feet, integrated by the classic fourth-order Runge-Kutta method."""

    def __init__(self, torso: Body, state: Array, force: Array):
        """Start at a state (12,) [rpy, p, omega, v] in odom, with ground forces (4, 3), N."""
        self.body = torso
        turn = Rotation.from_euler("xyz", state[:3])
        rate = turn.inv().apply(state[6:9])
        self.y = np.concatenate([state[3:6], turn.as_quat(), state[9:12], rate, force.ravel()])
        self.external = np.zeros(6)  # N and N m on the centre, odom
        self._inverse = np.linalg.inv(torso.inertia)

    @property
    def state(self) -> Array:
        """(12,) [roll pitch yaw, p, omega, v] in odom."""
        turn = Rotation.from_quat(self.y[QUATERNION])
        rpy = rpy_of(turn.as_matrix())
        return np.concatenate([rpy, self.y[POSITION], turn.apply(self.y[RATE]), self.y[VELOCITY]])

    def advance(self, command: Array, dt: float) -> None:
        """Place the feet, then hold the commanded forces (4, 3), N, for dt (s)."""
        feet, h = self.place_feet(dt / 2), dt / SUBSTEPS
        u = command.ravel()
        for _ in range(SUBSTEPS):
            k1 = self.slope(self.y, u, feet)
            k2 = self.slope(self.y + h / 2 * k1, u, feet)
            k3 = self.slope(self.y + h / 2 * k2, u, feet)
            k4 = self.slope(self.y + h * k3, u, feet)
            self.y = self.y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            self.y[QUATERNION] /= math.sqrt(self.y[QUATERNION] @ self.y[QUATERNION])

    def place_feet(self, ahead: float) -> Array:
        """(4, 3) m in odom: on the floor, where the legs will end `ahead` (s) from now."""
        place = np.column_stack([rotate(self.body.feet[:, :2], self.state[2]), np.zeros(4)])
        return place + np.append(self.y[:2] + ahead * self.y[VELOCITY][:2], 0.0)

    def slope(self, y: Array, u: Array, feet: Array) -> Array:
        """(25,) time derivative of the state y, forces included, under the commands u (12,), N."""
        torso, rate, q = self.body, y[RATE], y[QUATERNION]
        turn = Rotation.from_quat(q)  # normalises, as Runge-Kutta's stages are not
        force = friction_limited(y[FORCES].reshape(4, 3), torso.friction)
        arm = feet - y[POSITION]
        moment = turn.inv().apply(_cross(arm, force).sum(axis=0) + self.external[3:])
        spin = torso.inertia @ rate
        out = np.empty(25)
        out[POSITION] = y[VELOCITY]
        out[QUATERNION] = np.append(q[3] * rate + _cross(q[:3], rate), -q[:3] @ rate) / 2
        out[VELOCITY] = (force.sum(axis=0) + self.external[:3]) / torso.mass
        out[9] -= GRAVITY
        out[RATE] = self._inverse @ (moment - _cross(rate, spin))
        out[FORCES] = (u - y[FORCES]) / torso.lag
        return out


def friction_limited(force: Array, friction: float) -> Array:
    """(4, 3) N, ground forces: `force` limited by friction and to non-negative f_z."""
    normal = np.maximum(force[:, 2:], 0.0)
    most = friction * normal
    return np.hstack([np.clip(force[:, :2], -most, most), normal])


class TorsoLoop:
    """The torso under an MPC that stands on four feet and follows height and speed."""

    def __init__(self, robot: RobotParameters, settings: MpcSettings, torso: Body, state: Array):
        """Start at a state (12,) with a quarter of the weight in the MPC's model on each leg."""
        self._gaits = read_gaits()
        share = np.zeros((4, 3))
        share[:, 2] = robot.weight / 4
        self.torso = RigidTorso(torso, state, share)
        settings = config.replace(settings, {"acceptance.time_budget": math.inf})
        self._mpc, self._share, self.step = Mpc(robot, settings, lambda: 0.0), share[:, 2], 0

    def tick(self, disturb: Callable[[Array], Array]) -> TendonPlan:
        """One control step: the MPC solves for `disturb(state)`, its forces are held for DT."""
        measured = disturb(self.torso.state)
        plan = self._mpc.step(Estimate.exact(measured), self._preview(measured))
        self.torso.advance(plan.force[0], DT)
        self.step += 1
        return plan

    def _preview(self, state: Array) -> GaitPreview:
        gaits = self._gaits
        motion, velocity = np.zeros((gaits.stages, 12)), np.tile(VELOCITY_AHEAD, (gaits.stages, 1))
        motion[:, P_Z] = HEIGHT
        places = places_ahead(np.append(state[3:5], 0.0), velocity, DT)
        return standing(
            gaits.stages,
            stamp=to_ns(self.step * DT),
            dt=DT,
            friction=np.full((gaits.stages, 4), gaits.friction),
            normal_force=np.tile(self._share, (gaits.stages, 1)),
            reference=reference(state, places, velocity, motion),
            command=GaitCommand("stand", VELOCITY_AHEAD, np.array([HEIGHT, 0.0, 0.0])),
        )


def run_torso(
    robot: RobotParameters,
    settings: MpcSettings,
    change: Mapping[int, float],
    duration: float,
    noise: np.random.Generator | None = None,
) -> PerturbedRun:
    """Run a case from the reference state with `change`; `noise` is on the MPC's input state."""
    state = np.zeros(12)
    state[[P_Z, 9]] = HEIGHT, SPEED
    for place, value in change.items():
        state[place] = value
    loop = TorsoLoop(robot, settings, body(robot, read_gaits().friction), state)
    states, costs, infeasible = [], [], 0
    for _ in range(round(duration / DT)):
        states.append(loop.torso.state)
        result = loop.tick(lambda x: x if noise is None else x + NOISE * noise.normal(size=len(x)))
        infeasible += result.status != Status.SOLVED
        costs.append(result.report.cost)
    return PerturbedRun.of(DT * np.arange(len(costs)), costs, states, infeasible)


def _cross(a: Array, b: Array) -> Array:
    """(..., 3) a x b; np.cross takes ten times as long on four rows."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]
