"""A leg as printed, sections III-A to III-E, in NumPy as the authors' scripts.

A leg has N nodes q_i = (x_i, z_i, theta_i), eq. 1, in its plane: x outward, z above the floor.

    strain    eps_i = (l_i - dx)/dx,  f_i = E A_i eps_i along the segment from node i to i + 1
    bending   m_i = E I_i/dx (theta_{i+1} - theta_i),  M_i -= m_i,  M_{i+1} += m_i
    tendon    F_i += T n_i,  M_i -= (h_i/2) T n_{x,i}  on the first two thirds of the nodes
    floor     F_z = k delta + d ddelta/dt, delta = -z, where z < 0, eq. 2
    friction  F_x = -mu (m + M/4) g sign(v_x) where z <= 0, eq. 3
    springs   F = -k_r (r_i - r_{i,0});  damping  F = -c v_i,  M = -c omega_i
    masses    m_i d2r_i/dt2 = F_i + m_i g,  I_i domega_i/dt = M_i,  I_i = rho A_i dx^2/2
    step      v += h F/m,  r += h v,  and so for omega and theta;  h = 1e-4 s

Interpretation and defects:
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
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from slot_core import config
from slot_core.arrays import Array, checked
from slot_core.config import quantity
from slot_core.dynamics.simulated_robot import require_steps
from slot_core.refusal import DivergenceError
from slot_core.robot import GRAVITY, LEGS, RobotParameters


@dataclass(frozen=True)
class PaperSettings:
    """Settings of the paper's model: `config/paper.yaml`."""

    young_modulus: float = quantity("Young's modulus", "Pa", 1e4, 1e10)
    nodes: int = quantity("nodes of a leg", "", 4, 401)
    step: float = quantity("time step", "s", 1e-7, 1e-2)
    restoring_stiffness: float = quantity(
        "spring from each node to its initial position", "N/m", 0, 1e6
    )
    damping: float = quantity(
        "linear damping, N s/m of a node and N m s of its angle", "", 0.0, 1e3
    )
    contact_stiffness: float = quantity(
        "contact stiffness of a node", "N/m", 0.0, 1e8
    )
    contact_damping: float = quantity(
        "contact damping of a node", "N s/m", 0.0, 1e4
    )
    friction: float = quantity("Coulomb friction", "", 0.0, 5.0)
    servo_torque: float = quantity(
        "torque at the end of the servo's range", "N m", 0.0, 100.0
    )
    servo_range_deg: float = quantity("range of the servo", "deg", 1.0, 3600.0)
    tension_scale: float = quantity(
        "factor of the robot's tensions", "", 0.0, 1.0
    )
    weight_share: float = quantity(
        "part of the torso's weight on each leg's base", "", 0.0, 1.0
    )
    torso_drag: float = quantity(
        "horizontal damping of the torso", "N s/m", 0.0, 1e4
    )
    torso_stiffness: float = quantity(
        "vertical spring of the torso", "N/m", 0.0, 1e6
    )
    torso_damping: float = quantity(
        "vertical damping of the torso", "N s/m", 0.0, 1e5
    )
    speed_limit: float = quantity(
        "speed of a node above which the solution has diverged", "m/s", 1.0, 1e6
    )


def read_paper() -> PaperSettings:
    """The settings of `config/paper.yaml`; raises ConfigError."""
    return config.read(PaperSettings, "paper")


def tension_of(
    settings: PaperSettings, robot: RobotParameters, angle: Array
) -> Array:
    """Tensions (N) at tendon angles (rad): T = (angle / range) torque / spool radius."""
    torque = (
        angle / math.radians(settings.servo_range_deg) * settings.servo_torque
    )
    return np.asarray(torque / robot.tendon.spool_radius)


class PaperLegs:
    """K legs side by side, each in its plane, at rest in their initial shape at first."""

    def __init__(  # noqa: PLR0917
        self,
        robot: RobotParameters,
        settings: PaperSettings,
        count: int = 1,
        touching: int = 0,
        base_load: float = 0.0,
        gravity: float = GRAVITY,
    ) -> None:
        """Lay out the nodes of `count` legs.

        touching: first node that can touch the floor. base_load: downward force on the base, N.
        gravity: m/s^2, downwards.
        """
        leg, nodes = robot.leg, settings.nodes
        thickness = np.linspace(leg.thickness_clamp, leg.thickness_tip, nodes)
        area = leg.width * thickness
        second_moment = leg.width * thickness**3 / 12
        x = np.linspace(0.0, leg.reach, nodes)
        self.settings, self.touching, self.base_load = (
            settings,
            touching,
            base_load,
        )
        self.spacing = leg.reach / (nodes - 1)  # m, dx
        self.mass = _masses(leg.density * area * self.spacing)  # (N,) kg
        self.inertia = leg.density * area * self.spacing**2 / 2  # (N,) kg m
        self.axial = settings.young_modulus * area[:-1]  # (N-1,) N, E A
        self.bending = (
            settings.young_modulus * second_moment[:-1] / self.spacing
        )
        # N
        self.friction = (
            settings.friction * (leg.mass + robot.mass / 4) * gravity
        )
        self.initial = np.stack([x, leg.shape(x)])  # (2, N) m, x and z
        end = int(robot.tendon.end_fraction * nodes)
        self.pull, self.turn = _tendon(self.initial, thickness, end)
        # (2, N) N
        self.weight = np.stack([np.zeros(nodes), self.mass * gravity])
        self.node = np.tile(self.initial, (count, 1, 1))  # (K, 2, N) m
        self.velocity = np.zeros_like(self.node)  # (K, 2, N) m/s
        self.angle = np.zeros((count, nodes))  # rad; no force depends on it
        # rad/s; only the angle depends on it
        self.rate = np.zeros((count, nodes))
        # N, F_i: sum of the forces on node 0
        self.base_force = np.zeros((count, 2))
        self.steps = 0

    def advance(self, steps: int, tension: Array) -> None:
        """Advance by steps of `settings.step` at constant tensions (K,), N.

        Raises ValueError for a negative number of steps or a tension that is not finite, and
        DivergenceError when a speed is not finite or above `settings.speed_limit`.
        """
        require_steps(steps)
        tension = checked("tension", tension, (len(self.node),))
        h = self.settings.step
        for _ in range(steps):
            self.steps += 1
            if place := self.step(tension, h):
                raise divergence(self.steps * h, self.settings, place)

    def step(self, tension: Array, h: float) -> str:
        """Advance by one step of h (s); the first node that is too fast or NaN, or ""."""
        settings = self.settings
        with np.errstate(over="ignore", invalid="ignore"):  # of the angles
            force = self._forces(tension)
            self.base_force[:] = force[..., 0]
            force[:, 0, 0] = 0.0  # x of the base is held by the guide
            moment = self._moments(tension) - settings.damping * self.rate
            self.velocity += h * force / self.mass
            self.node += h * self.velocity
            self.rate += h * moment / self.inertia
            self.angle += h * self.rate
            square = np.square(self.velocity).sum(axis=1)
        fast = ~(square <= settings.speed_limit**2)  # true for NaN
        if not fast.any():
            return ""
        leg, node = divmod(int(fast.argmax()), settings.nodes)
        return f"leg {LEGS[leg]} node {node}"

    def _forces(self, tension: Array) -> Array:
        """(K, 2, N) N, sum of the forces on the nodes but for inertia."""
        settings = self.settings
        chord = self.node[..., 1:] - self.node[..., :-1]
        length = np.sqrt(np.square(chord).sum(axis=1))
        axial = self.axial * (length - self.spacing) / self.spacing
        force = self.pull * tension[:, None, None]
        force -= settings.damping * self.velocity
        force -= self.weight
        force -= settings.restoring_stiffness * (self.node - self.initial)
        force[:, 1, 0] -= self.base_load
        force[..., self.touching :] += self.floor_force()
        return force + _on_nodes(axial[:, None] * chord / length[:, None])

    def _moments(self, tension: Array) -> Array:
        """(K, N) N m, sum of the moments on the nodes but for inertia and damping."""
        bending = self.bending * (self.angle[:, 1:] - self.angle[:, :-1])
        return self.turn * tension[:, None] - _on_nodes(bending)

    def floor_force(self) -> Array:
        """(K, 2, n) N, friction and normal force on the nodes that can touch the floor."""
        settings, velocity = self.settings, self.velocity[..., self.touching :]
        z, vz = self.node[:, 1, self.touching :], velocity[:, 1]
        normal = -settings.contact_stiffness * z - settings.contact_damping * vz
        force = -self.friction * np.sign(velocity)
        force[:, 0] *= z <= 0.0
        force[:, 1] = normal * (z < 0.0)
        return force


def divergence(
    time: float,
    settings: PaperSettings,
    place: str,
    state: Mapping[str, Any] | None = None,
) -> DivergenceError:
    """Error of a solution that has diverged at a time (s) and a place."""
    limit = settings.speed_limit
    return DivergenceError(
        f"simulation diverged at {time:.4f} s: {place} is beyond {limit} m/s or not a number",
        state,
    )


def _on_nodes(segment: Array) -> Array:
    """(.., N) sums at the nodes: of each segment (.., N-1) plus at its begin, minus at its end."""
    total = np.zeros((*segment.shape[:-1], segment.shape[-1] + 1))
    total[..., :-1] = segment
    total[..., 1:] -= segment
    return total


def _masses(segment: Array) -> Array:
    """(N,) node masses, kg, from rho A_i dx (N,): means of i - 1 and i; half of it at the ends."""
    mass = segment.copy()
    mass[1:-1] = (segment[:-2] + segment[1:-1]) / 2
    mass[[0, -1]] /= 2
    return mass


def _tendon(initial: Array, thickness: Array, end: int) -> tuple[Array, Array]:
    """(2, N) force and (N,) moment, m, per newton of tension on the nodes before `end`."""
    dx, dz = np.gradient(initial, axis=1)
    normal = np.stack([-dz, dx]) / np.hypot(dx, dz)
    normal[:, end:] = 0.0
    return normal, -thickness / 2 * normal[0]
