"""The robot as printed, section IV: four legs as in `leg`, and a rigid torso that they move.

Only the tips touch the floor, each leg moves independently, and its reaction moves the torso,
without the gyroscopic term (eq. 4, 5):

    m_c d2p/dt2 = sum F_i,  I_c domega/dt = sum r_i x F_i.

Interpretation and defects:
- The coupling is one-way: the torso does not act on the legs, and the heights of torso and legs are
  independent.
- F_i is taken as the force of a leg on the torso: the sum of the forces on node 0. S has the
  opposite sign for the walk, and for the crawl reverses it together with the sign of the drag. The
  base is free in z, so the mean of F_z is zero; F_x of a leg pulls outward by tens of newtons.
- Eq. 5 has no gravity; the text of P and S do. "Damping and restoring forces" on the torso are,
  from S, a horizontal drag and a vertical spring and damper. The spring is relaxed at the start
  height here (S: at -0.175 or -0.15 m, plotted with the opposite sign). Yaw, roll and pitch have
  neither. The torso's weight, which this spring carries, also loads the bases of the legs (S).
- F_i and r_i rotate with the torso; P does not state it, and S has no rotation.
- T = (angle/270 deg) 1.5 N m/10 mm (S): no lag, no speed limit, no tendon length. For the robot S
  multiplies it by 4e-4 (walk) or 1e-4 (crawl): `tension_scale`.
"""

from dataclasses import dataclass

import numpy as np

from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamics.simulated_robot import SimulatedRobot, require_steps
from slot_core.matrices import product
from slot_core.mpc.model import lever_arms
from slot_core.robot import LEGS, RobotParameters
from slot_paper.leg import (
    PaperLegs,
    PaperSettings,
    divergence,
    read_paper,
    tension_of,
)


@dataclass(frozen=True)
class PaperState:
    """Motion of torso and tendons; the arrays are written in place."""

    position: Array  # (3,) m, odom
    rotation: Array  # (3, 3) base_link to odom
    velocity: Array  # (3,) m/s, odom
    rate: Array  # (3,) rad/s, base_link
    # (3,) m/s^2, base_link, mean over the last step of the scene
    specific_force: Array
    tendon_angle: Array  # (4,) rad, equal to the command
    # (4,) rad/s, over the last step: the command's change in its first step, then zero
    tendon_rate: Array
    tension: Array  # (4,) N, of the tendons


class PaperRobot(SimulatedRobot):
    """Simulated robot after the paper, interchangeable with `RodRobot`.

    Of the scene it uses start, gravity and solver step. Contact and friction are those of the
    settings, not of the scene's floor. The servo settings are ignored: the tension follows the
    command without delay or limit.

    Raises ConfigError when the scene's gravity is not along z or when its step is no multiple of
    `settings.step`; DivergenceError when settling is unstable, as it is with the printed numbers.
    """

    def __init__(
        self,
        robot: RobotParameters,
        scene: Scene,
        servo: ServoSettings,
        settings: PaperSettings | None = None,
    ) -> None:
        self.parameters, self.scene = robot, scene
        self.settings = settings or read_paper()
        self._substeps = _substeps(scene, self.settings)
        gravity = -_vertical(scene)
        load = self.settings.weight_share * robot.torso.mass * gravity
        tip = self.settings.nodes - 1
        self.legs = PaperLegs(
            robot, self.settings, len(LEGS), tip, load, gravity
        )
        self._outward, self._arms = robot.outward, lever_arms(robot.clamps)
        self._mobility = 1.0 / np.diag(robot.torso.inertia)
        drag, damping = self.settings.torso_drag, self.settings.torso_damping
        self._drag = np.array([drag, drag, damping])
        height = np.array([0.0, 0.0, scene.start.height])
        still = np.zeros((3, 3))
        self.state = PaperState(
            height, np.eye(3), *still, *np.zeros((3, len(LEGS)))
        )
        self._settle()

    def advance(self, steps: int, command: Array) -> None:
        """Advance `steps` steps of the scene at constant commanded tendon angles (4,), rad.

        Raises ValueError for a negative number of steps, a command of the wrong shape, not finite
        or outside [0, angle_max], and DivergenceError when a speed is not finite or above
        `settings.speed_limit`.
        """
        require_steps(steps)
        command, now = self.checked(command), self.state
        if steps > 0:
            jump = command - now.tendon_angle if steps == 1 else np.zeros(4)
            now.tendon_rate[:] = jump / self.scene.solver.step
            now.tendon_angle[:] = command
            tension = tension_of(self.settings, self.parameters, command)
            now.tension[:] = self.settings.tension_scale * tension
        h = self.scene.solver.step / self._substeps
        for _ in range(steps):
            self.steps += 1
            earlier = self.state.velocity.copy()
            for _ in range(self._substeps):
                if place := self.legs.step(now.tension, h):
                    state = self.snapshot() | {"command": command}
                    raise divergence(self.time, self.settings, place, state)
                self._step_torso(h)
            change = (self.state.velocity - earlier) / self.scene.solver.step
            felt = change - self.scene.gravity
            self.state.specific_force[:] = _times(self.state.rotation.T, felt)

    def _step_torso(self, h: float) -> None:
        """Semi-implicit Euler step of h (s) under the legs' forces, gravity, spring and damping."""
        settings, state, torso = (
            self.settings,
            self.state,
            self.parameters.torso,
        )
        reaction = self.legs.base_force[:, :1] * self._outward
        reaction[:, 2] = self.legs.base_force[:, 1]
        force = _times(state.rotation, reaction.sum(axis=0))
        above = state.position[2] - self.scene.start.height
        force[2] -= settings.torso_stiffness * above
        force -= self._drag * state.velocity
        state.velocity[:] += h * (force / torso.mass + self.scene.gravity)
        state.position[:] += h * state.velocity
        moment = _times(self._arms, reaction.ravel())
        state.rate[:] += h * self._mobility * moment
        turn = _times(state.rotation, _rotation(h * state.rate))
        state.rotation[:] = turn

    @property
    def nodes(self) -> Array:
        """(4, N, 3) m in odom, base first: x, y from the torso's corners, z of the legs' own."""
        x, z = np.moveaxis(self.legs.node, 1, 0)
        body = (
            self.parameters.clamps[:, None]
            + x[..., None] * self._outward[:, None]
        )
        turned = product(body.reshape(-1, 3), self.state.rotation.T)
        out = self.state.position + turned.reshape(body.shape)
        out[..., 2] = z
        return out

    @property
    def ground_force(self) -> Array:
        """(4, 3) N in odom, present force of the floor on the tip of each leg."""
        friction, normal = self.legs.floor_force()[..., 0].T
        along = friction[:, None] * self._outward
        out = np.asarray(product(along, self.state.rotation.T))
        out[:, 2] = normal
        return out


def _times(matrix: Array, other: Array) -> Array:
    """Product of a matrix and a vector or a matrix."""
    if other.ndim == 1:
        return np.asarray((matrix * other).sum(axis=1))
    return np.asarray((matrix[..., None] * other).sum(axis=1))


def _rotation(turn: Array) -> Array:
    """Rotation matrix of a small vector, rad, by Rodrigues' formula, exact to 1e-14 at 0.03 rad."""
    (x, y, z), square = turn, float((turn * turn).sum())
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first = 1.0 - square / 6.0 * (1.0 - square / 20.0)
    second = 0.5 - square / 24.0 * (1.0 - square / 30.0)
    return np.asarray(np.eye(3) + first * cross + second * _times(cross, cross))


def _vertical(scene: Scene) -> float:
    """Gravity of the scene along z, m/s^2; raises ConfigError when it has other components."""
    x, y, z = scene.gravity
    if x or y:
        raise ConfigError(
            f"gravity = {scene.gravity}: the paper's legs have gravity along z alone"
        )
    return z


def _substeps(scene: Scene, settings: PaperSettings) -> int:
    """Number of steps of the settings in a step of the scene; raises ConfigError if not whole."""
    ratio = scene.solver.step / settings.step
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        raise ConfigError(
            f"solver.step = {scene.solver.step}: no multiple of {settings.step} s"
        )
    return round(ratio)
