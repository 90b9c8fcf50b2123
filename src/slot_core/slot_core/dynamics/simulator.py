"""The simulated robot: torso, four legs, tendons and servos on the floor of a scene."""

from __future__ import annotations

import numpy as np

from slot_core.dynamics import integrator, observe
from slot_core.dynamics.handle import Handle
from slot_core.dynamics.model import (
    State,
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
from slot_core.dynamics.simulated_robot import Divergence, SimulatedRobot
from slot_core.robot import LEGS, Array, Robot


class Simulator(SimulatedRobot):
    """The robot on legs that are rods (`integrator.py`).

    It starts with natural legs and slack tendons at `scene.start`, settles there under a constant
    command, and only then counts time from zero. Equal inputs give equal results to the last bit.
    """

    state: State

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
        scheme = build_scheme(scene.solver, self.model.floor)
        self._machine = Handle((self.model, self.state, self._work, start, self._legs, scheme))
        self._points = np.zeros((2, 4, scene.solver.nodes, 3))
        self._settle()

    def advance(self, steps: int, command: Array) -> None:
        """Advance `steps` steps with the commanded tendon angles (4,), rad, held.

        Raises ValueError on a command of the wrong shape, not finite or outside [0, angle_max], and
        Divergence when a speed is not finite or beyond `scene.solver.speed_limit`.
        """
        command = self.checked(command)
        self._legs.command[0] = command
        done, where = integrator.advance(self._machine, steps)
        self.steps += done
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

        They act from now on; adding the opposite ends that. Raises ValueError unless all is finite.
        """
        push = np.array([*force, *moment], dtype=float)
        if push.shape != (6,) or not np.isfinite(push).all():
            raise ValueError(f"a push is a finite force (3,) and moment (3,), not {push}")
        self.model.push[:] += push

    def spoil_tendon(self, leg: int, slack: float = 0.0, broken: bool = False) -> None:
        """From now on the tendon of leg 0 .. 3 is longer by `slack` (m), or broken.

        Raises ValueError on another leg or a slack that is negative or not finite.
        """
        if leg not in range(4) or not 0.0 <= slack < np.inf:
            raise ValueError(f"leg {leg} must be 0 to 3, slack {slack} m not negative and finite")
        self.model.fault[:, leg] = slack, not broken

    @property
    def halvings(self) -> int:
        """How often a step was taken again in pieces half as long."""
        return int(self._work.counter[0])

    @property
    def indefinite_steps(self) -> int:
        """Steps in which a pivot was not positive: a sign of a fold or of too large a step."""
        return int(self._work.counter[1])

    @property
    def unconverged_steps(self) -> int:
        """Steps that ran out of halvings and were accepted with too large a correction."""
        return int(self._work.counter[2])

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

    def _explain(self, where: int) -> str:
        leg, node = divmod(where - 1, self.scene.solver.nodes)
        place = f"leg {LEGS[leg]} node {node}" if where else "torso"
        limit = self.scene.solver.speed_limit
        return (
            f"solution lost in step {self.steps + 1} at {self.time:.4f} s: {place} is beyond"
            f" {limit} m/s or not a number"
        )
