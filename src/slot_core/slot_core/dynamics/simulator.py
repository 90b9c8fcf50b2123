"""The simulated robot: torso, four legs, tendons and servos on the floor of a scene."""

from __future__ import annotations

import math

import numpy as np

from slot_core.dynamics import integrator, observe
from slot_core.dynamics.handle import Handle
from slot_core.dynamics.model import (
    build_model,
    build_scheme,
    leg_lanes,
    rest_state,
    state_space,
    work_space,
)
from slot_core.dynamics.rod import segments
from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.robot import LEGS, Array, Robot


class Divergence(RuntimeError):  # noqa: N818 - it names the event
    """The solution is lost; the message names the time, the leg or the torso, and the node."""


class Simulator:
    """The robot in a scene, advanced in steps of `scene.solver.step`.

    It starts with natural legs and slack tendons at `scene.start`, settles there under a constant
    command, and only then counts time from zero. Equal inputs give equal results to the last bit.

    All arrays that the properties return are copies; legs are in the order FL FR RL RR.
    """

    def __init__(self, robot: Robot, scene: Scene, servo: ServoSettings) -> None:
        self.robot = robot
        self.scene = scene
        self.model = build_model(robot, scene, servo)
        self.state = rest_state(self.model, scene.start.height)
        self._legs = leg_lanes(self.model, self.state)
        self._work = work_space()
        self._segments = segments(scene.solver.nodes)
        bristles = self.model.floor.bristle > 0.0
        start = state_space(scene.solver.nodes, bristles)
        scheme = build_scheme(scene.solver)
        self._machine = Handle((self.model, self.state, self._work, start, self._legs, scheme))
        self._points = np.zeros((2, 4, scene.solver.nodes, 3))
        self._steps = 0
        self._settle()

    def advance(self, steps: int, command: Array) -> None:
        """Advance `steps` steps with the commanded tendon angles (4,), rad, held.

        Raises ValueError on a command of the wrong shape, not finite or outside [0, angle_max], and
        Divergence when a speed is not finite or beyond `scene.solver.speed_limit`.
        """
        command = self.checked(command)
        self._legs.command[0] = command
        done, where = integrator.advance(self._machine, steps)
        self._steps += done
        if where >= 0:
            raise Divergence(self._explain(where))

    def set_motion(self, velocity: Array, angular_velocity: Array) -> None:
        """Let the whole robot move rigidly: (3,) m/s in odom, (3,) rad/s in base_link."""
        self.state.velocity[:] = velocity
        self.state.rate[:] = angular_velocity
        arm = np.einsum("ij,lnj->lni", self.state.rotation.T, self.nodes - self.position)
        body = self.state.rotation.T @ velocity + np.cross(angular_velocity, arm)
        self.state.node_velocity[:] = np.einsum("lij,lnj->lni", self.model.axes, body)

    def push(self, force: Array, moment: Array) -> None:
        """Add an outer force (3,), N, and moment (3,), N m, on the torso's centre, in odom.

        They act from now on; adding the opposite ends that.
        """
        self.model.push[:] += [*force, *moment]

    def spoil_tendon(self, leg: int, slack: float = 0.0, broken: bool = False) -> None:
        """From now on a leg's tendon is longer by `slack` (m), or broken."""
        self.model.fault[:, leg] = slack, not broken

    @property
    def time(self) -> float:
        """Seconds since the end of settling."""
        return self._steps * self.scene.solver.step

    @property
    def halvings(self) -> int:
        """How often a step was taken again in pieces half as long."""
        return int(self._work.counter[0])

    @property
    def indefinite_steps(self) -> int:
        """Steps in which a pivot was not positive: a sign of a fold or of too large a step."""
        return int(self._work.counter[1])

    @property
    def position(self) -> Array:
        """(3,) m, torso's centre in odom."""
        return self.state.position.copy()

    @property
    def rotation(self) -> Array:
        """(3, 3) base_link to odom."""
        return self.state.rotation.copy()

    @property
    def quaternion(self) -> Array:
        """(4,) x y z w, base_link to odom, w >= 0."""
        return quaternion(self.state.rotation)

    @property
    def rpy(self) -> Array:
        """(3,) rad, roll pitch yaw about fixed x, y, z: R = R_z(yaw) R_y(pitch) R_x(roll)."""
        r = self.state.rotation
        pitch = math.asin(min(1.0, max(-1.0, -r[2, 0])))
        return np.array([math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])])

    @property
    def velocity(self) -> Array:
        """(3,) m/s, torso's centre in odom."""
        return self.state.velocity.copy()

    @property
    def angular_velocity(self) -> Array:
        """(3,) rad/s, base_link."""
        return self.state.rate.copy()

    @property
    def specific_force(self) -> Array:
        """(3,) m/s^2, base_link: acceleration minus gravity at the centre, mean over a step."""
        return self.state.specific_force.copy()

    @property
    def tendon_angle(self) -> Array:
        """(4,) rad, angle of the spools."""
        return self.state.tendon_angle.copy()

    @property
    def tendon_rate(self) -> Array:
        """(4,) rad/s, over the last step."""
        return self.state.tendon_rate.copy()

    @property
    def tension(self) -> Array:
        """(4,) N, of the tendons, at the stage of the last step."""
        return self.state.tension.copy()

    @property
    def servo_torque(self) -> Array:
        """(4,) N m, load on the servos: tension times spool radius."""
        return self.state.tension * self.model.tendon.spool_radius

    @property
    def nodes(self) -> Array:
        """(4, N, 3) m, nodes of the legs in odom, clamp first."""
        return self._observe()[0].copy()

    @property
    def ground_force(self) -> Array:
        """(4, 3) N in odom, what the floor exerts on each leg now."""
        force = np.zeros((4, 3))
        observe.ground_forces(self.model, self.state, *self._observe(), force)
        return force

    def momentum(self) -> tuple[Array, Array]:
        """(3,) kg m/s and (3,) kg m^2/s about odom's origin, in odom."""
        out = np.zeros((2, 3))
        observe.momenta(self.model, self.state, *self._observe(), out)
        return out[0], out[1]

    def energy(self) -> float:
        """J: kinetic, gravity (zero at odom's origin), rods, cables, floor and bristles."""
        return float(observe.energy(self.model, self.state, self._segments, *self._observe()))

    def _observe(self) -> tuple[Array, Array]:
        observe.points(self.model, self.state, self._points[0], self._points[1])
        return self._points[0], self._points[1]

    def _settle(self) -> None:
        start = self.scene.start
        command = np.full(4, math.radians(start.tendon_angle_deg))
        self.advance(round(start.settle / self.scene.solver.step), command)
        self._steps = 0

    def checked(self, command: Array) -> Array:
        """The command as `advance` takes it; raises ValueError as it does."""
        command = np.array(command, dtype=np.float64)
        limit = self.robot.tendon.angle_max
        if command.shape != (4,):
            raise ValueError(f"command has the shape {command.shape}, not (4,)")
        if not all(0.0 <= angle <= limit for angle in command.tolist()):
            raise ValueError(f"command {command} rad is not inside [0, {limit:.6f}]")
        return command

    def _explain(self, where: int) -> str:
        leg, node = divmod(where - 1, self.scene.solver.nodes)
        place = f"leg {LEGS[leg]} node {node}" if where else "torso"
        limit = self.scene.solver.speed_limit
        return f"solution lost at {self.time:.4f} s: {place} is beyond {limit} m/s or not a number"


def quaternion(rotation: Array) -> Array:
    """(4,) x y z w of a rotation matrix, w >= 0 (Bar-Itzhack: eigenvector of a 4 x 4 matrix)."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]],
            [0.0, r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]],
            [0.0, 0.0, r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
            [0.0, 0.0, 0.0, r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    q = np.linalg.eigh(k, UPLO="U")[1][:, -1]
    return q if q[3] >= 0.0 else -q
