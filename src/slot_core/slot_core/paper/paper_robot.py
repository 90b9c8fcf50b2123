"""The published model of leg and robot, as printed: the baseline of comparisons.

P: S. Karan, N. Maram, S. Borate, M. Vadali, "Dynamic Modeling and MPC for Locomotion of
Tendon-Driven Soft Quadruped". S: the scripts that its authors published. S supplies what P leaves
open; where S contradicts P, P is used. Numbers are in `config/paper.yaml`; geometry and masses are
the robot's.

A leg, sections "Single leg dynamic model" to "Node-level dynamic equations", has N nodes
q_i = (x_i, z_i, theta_i), eq. 1, in its plane: x outward, z above the floor.

    strain    eps_i = (l_i - dx)/dx,  f_i = E A_i eps_i along the segment from node i to i + 1
    bending   m_i = E I_i/dx (theta_{i+1} - theta_i),  M_i -= m_i,  M_{i+1} += m_i
    tendon    F_i += T n_i,  M_i -= (h_i/2) T n_{x,i}  on the first two thirds of the nodes
    floor     F_z = k delta + d ddelta/dt, delta = -z, where z < 0, eq. 2
    friction  F_x = -mu (m + M/4) g sign(v_x) where z <= 0, eq. 3
    springs   F = -k_r (r_i - r_{i,0});  damping  F = -c v_i,  M = -c omega_i
    masses    m_i d2r_i/dt2 = F_i + m_i g,  I_i domega_i/dt = M_i,  I_i = rho A_i dx^2/2
    step      v += h F/m,  r += h v,  and so for omega and theta;  h = 1e-4 s

Interpretation and defects of the leg:
- P uses theta_i twice: for the direction arctan2(..) of a segment and for the state of a node. S
  integrates the state from zero. No force depends on it, so bending does not act on the shape.
- The bending moments are anti-restoring. I_i is no moment of inertia: its unit is kg m. With it
  c h/I is 6 at the tip, and 2 is the stability limit. The state overflows within 0.1 s of a pull;
  it is left infinite or NaN and excluded from the check for divergence.
- P says explicit Euler; S advances the position with the new velocity, as here.
- P routes the tendon over a virtual pulley (168 deg, 30 mm), which S only draws. S applies the
  whole tension T to each of the 20 nodes along the normal n_i of the initial shape, so that a leg
  of 39 g is lifted by up to 20 x 64.6 N = 1.3 kN without a reaction. P gives no equation; S is
  used.
- dx = L/(N-1) is below the length of the initial segments: the initial shape is stretched.
- The base: S fixes x_0 and leaves z_0 free, though the node is called fixed.
- m_i: S averages rho A dx of nodes i - 1 and i, as here. S has no bending in the last segment; not
  adopted. S has friction mu m_i g; eq. 3 is used. S halves all speeds in each step without tension
  and drops the tension of a lifted tip; neither is printed, and neither is adopted.
- Contact: the tip is stable while k h^2/m + 2 d h/m < 4, up to h = 4.4e-5 s. The printed step is
  larger, so the solution lasts only while the tip stays off the floor. The normal force may be
  tensile.

The robot, section "SLOT whole-body modeling": only the tips touch the floor, each leg moves
independently, and its reaction moves the torso, without the gyroscopic term (eq. 4, 5):

    m_c d2p/dt2 = sum F_i,  I_c domega/dt = sum r_i x F_i.

Interpretation and defects of the robot:
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

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from slot_core.arrays import Array, checked
from slot_core.config import ConfigError
from slot_core.dynamics.handle import Handle
from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamics.simulated_robot import SimulatedRobot, require_steps
from slot_core.paper.kernels import advance_legs, advance_robot
from slot_core.paper.numbers import (
    PaperSettings,
    leg_model,
    leg_state,
    read_paper,
    tension_of,
    torso_model,
    torso_state,
)
from slot_core.refusal import DivergenceError
from slot_core.robot import LEGS, RobotParameters


class PaperLeg:
    """Single leg: its base is guided vertically, and every node can touch the floor.

    It starts at rest in its initial shape. The properties return copies, in the plane of the leg:
    x outward from the base, z above the floor.
    """

    def __init__(self, robot: RobotParameters, settings: PaperSettings) -> None:
        self.settings = settings
        self.model = leg_model(robot, settings, touching=0, base_load=0.0)
        self.state = leg_state(self.model, 1)
        self._handle = Handle((self.model, self.state))
        self.steps = 0

    def advance(self, steps: int, tension: float) -> None:
        """Advance `steps` steps of `settings.step` at a constant tension, N.

        Raises ValueError for a negative number of steps or a tension that is not finite, and
        DivergenceError when a speed is not finite or above `settings.speed_limit`.
        """
        require_steps(steps)
        self.state.tension[0] = checked("tension", tension, ())
        done, failed = advance_legs(self._handle, steps, self.settings.step)
        self.steps += done
        if failed >= 0:
            raise _divergence(self.time, self.settings, f"node {failed}")

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.steps * self.settings.step

    @property
    def nodes(self) -> Array:
        """(N, 2) node positions, m."""
        return self.state.node[0].copy()

    @property
    def velocities(self) -> Array:
        """(N, 2) node velocities, m/s."""
        return self.state.velocity[0].copy()

    @property
    def angles(self) -> Array:
        """(N,) angle states, rad; not finite within 0.1 s of the first tension."""
        return self.state.angle[0].copy()


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
        load = self.settings.weight_share * robot.torso.mass * -_vertical(scene)
        last = self.settings.nodes - 1
        self.model = leg_model(robot, self.settings, last, load, -_vertical(scene))
        self.torso = torso_model(robot, scene, self.settings)
        self.legs, self.state = (
            leg_state(self.model, 4),
            torso_state(scene.start.height),
        )
        self._handle = Handle((self.model, self.legs, self.torso, self.state))
        self._angle, self._rate = np.zeros(4), np.zeros(4)
        self._settle()

    def advance(self, steps: int, command: Array) -> None:
        """Advance `steps` steps of the scene at constant commanded tendon angles (4,), rad.

        Raises ValueError for a negative number of steps, a command of the wrong shape, not finite
        or outside [0, angle_max], and DivergenceError when a speed is not finite or above
        `settings.speed_limit`.
        """
        require_steps(steps)
        command = self.checked(command)
        self._set_tension(command, steps)
        h = self.scene.solver.step / self._substeps
        done, failed = advance_robot(self._handle, steps, self._substeps, h)
        self.steps += done
        if failed >= 0:
            leg, node = divmod(failed, self.settings.nodes)
            state = self.snapshot() | {"command": command}
            raise _divergence(
                self.time, self.settings, f"leg {LEGS[leg]} node {node}", state
            )

    @property
    def tendon_angle(self) -> Array:
        """(4,) rad, equal to the command."""
        return self._angle.copy()

    @property
    def tendon_rate(self) -> Array:
        """(4,) rad/s, over the last step: the command's change in its first step, then zero."""
        return self._rate.copy()

    @property
    def tension(self) -> Array:
        """(4,) N, of the tendons."""
        return self.legs.tension.copy()

    @property
    def nodes(self) -> Array:
        """(4, N, 3) m in odom, base first: x, y from the torso's corners, z of the legs' own."""
        out = self._from_corners(self.legs.node[..., 0])
        out[..., 2] = self.legs.node[..., 1]
        return out

    @property
    def ground_force(self) -> Array:
        """(4, 3) N in odom, present force of the floor on the tip of each leg."""
        z, (vx, vz) = self.legs.node[:, -1, 1], self.legs.velocity[:, -1].T
        s = self.settings
        normal = np.where(
            z < 0.0, -s.contact_stiffness * z - s.contact_damping * vz, 0.0
        )
        friction = np.where(z <= 0.0, -self.model.friction * np.sign(vx), 0.0)
        out = np.einsum(
            "ij,lj,l->li", self.state.rotation, self.parameters.outward, friction
        )
        out[:, 2] = normal
        return out

    def _from_corners(self, x: Array) -> Array:
        """(4, N, 3) m in odom, points at distances x (4, N) outward from the torso's corners."""
        body = (
            self.parameters.clamps[:, None]
            + x[..., None] * self.parameters.outward[:, None]
        )
        return np.asarray(self.state.position + body @ self.state.rotation.T)

    def _set_tension(self, command: Array, steps: int) -> None:
        if steps > 0:
            jump = command - self._angle if steps == 1 else np.zeros(4)
            self._rate[:] = jump / self.scene.solver.step
            self._angle[:] = command
            self.legs.tension[:] = self.settings.tension_scale * tension_of(
                self.settings, self.parameters, command
            )


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


def _divergence(
    time: float,
    settings: PaperSettings,
    place: str,
    state: Mapping[str, Any] | None = None,
) -> DivergenceError:
    limit = settings.speed_limit
    return DivergenceError(
        f"simulation diverged at {time:.4f} s: {place} is beyond {limit} m/s or not a number",
        state,
    )
