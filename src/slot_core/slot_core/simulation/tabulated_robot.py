"""A rigid torso on legs without mass: the forces of each are those of a leg at rest, from a table.

A leg at tendon angle theta whose foot is eta below its clamp carries F(theta, eta), at x(theta,
eta) outward from the clamp, under the tension T(theta, eta): `config/leg_map.csv`, of a leg on a
frictionless floor. The foot is at r = c + x a - eta k in the torso's axes, with the clamp c, the
leg's azimuth a and the torso's vertical k; eta is such that r is on the floor, whose normal is n.
The material there shifts outward by x_theta and x_eta, other than x where the leg rolls.
As the torso moves, n.dr = 0 gives d eta = (n.(dp + dphi x r) + n.a x_theta dtheta) / D with
D = n.k - n.a x_eta, and the principle of virtual work, with friction f at r and m = x_eta a - k,

    N = (F + beta dF/dt + f.m) / D          normal force at r,
    T' = T + beta dT/dt - x_theta (f.a + (F + beta dF/dt + f.m) n.a / D) / r_spool.

beta is the Kelvin-Voigt time of the material: stress E (e + beta de/dt) makes F + beta dF/dt of F
wherever F is linear in the deformation. Where the map's stiffness is positive, at the fold of a
leg that is fully pulled and high up, dF/dt has no part of the height, lest it drives the motion.

What is left out: the legs' motion of their own (first frequency: 10 Hz hanging, 25 Hz standing);
what friction does to a leg's shape beyond the foot's path; the tilt of gravity in a leg. Contact is
that of the scene `flat`. The legs' mass and inertia belong to the torso, in their natural shape,
with the centre of mass at the torso's own.

Between the grid's points the map is bilinear. Below the lowest and above the highest height force
and tension go on along the plane of the edge's cell, down to zero; the rest stays. The table
belongs to the robot of `config/robot.yaml`: after a change there run `scripts/tabulate_leg`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slot_core.config import ConfigError
from slot_core.dynamics.handle import Handle
from slot_core.dynamics.model import build_model, build_scheme, state_space, work_space
from slot_core.dynamics.scene import Scene, read_scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamics.simulated_robot import Divergence
from slot_core.leg_table import LegTable, read_leg_table
from slot_core.robot import Array, Robot
from slot_core.simulation.kernel_robot import KernelRobot
from slot_core.simulation.tabulated_kernels import TOO_TILTED, UPRIGHT, Feet, MapLegs, advance

COLUMNS = ("force_N", "contact_x_m", "tension_N", "foot_m_per_rad", "foot_m_per_m")


class TabulatedRobot(KernelRobot):
    """The robot, as `RodRobot` is one, on legs from a table.

    Raises ConfigError, which names the setting, for what the table does not hold: a floor that is
    uneven or of another stiffness, contact of the tips alone, halved steps, a straight tendon. A
    torso tilted by more than 60 deg is a Divergence: the legs know what is below it alone.
    """

    def __init__(
        self, robot: Robot, scene: Scene, servo: ServoSettings, table: LegTable | None = None
    ) -> None:
        _refuse(robot, scene)
        self.robot, self.scene = robot, scene
        table = table or read_leg_table(COLUMNS)
        model = build_model(robot, scene, servo)
        # The legs' mass moves with the torso.
        whole = model.torso._replace(mass=robot.mass, inertia=robot.inertia)
        self.model = model._replace(torso=whole)
        self.legs = map_legs(robot, table)
        self._reach = _reach(table)
        self.state = state_space(1, self.model.floor.bristle > 0.0)
        self.state.position[2] = scene.start.height
        self.state.rotation[:] = np.eye(3)
        self.state.node[:, 0] = table.table[0, -1, 1], -scene.start.height
        self._feet = Feet(np.zeros(4), np.zeros((4, 3)), np.zeros(4), np.zeros(2))
        self._work = work_space()
        parts = (self.model, self.legs, self.state, self._feet, self._work)
        self._handle = Handle((*parts, build_scheme(scene.solver, self.model.floor)))
        self._settle()

    def advance(self, steps: int, command: Array) -> None:
        """Advance `steps` steps with the commanded tendon angles (4,), rad, held.

        Raises ValueError on a command of the wrong shape, not finite or outside [0, angle_max], and
        Divergence when a speed is not finite or too high, or the torso tilted too far.
        """
        self._feet.command[:] = self.checked(command)
        done, lost = advance(self._handle, steps)
        self.steps += done
        if lost >= 0:
            limit = f"torso is beyond {self.scene.solver.speed_limit} m/s or not a number"
            if lost == TOO_TILTED:
                limit = f"torso is tilted by more than {math.degrees(math.acos(UPRIGHT)):.0f} deg"
            state = self.snapshot() | {"command": self._feet.command.copy()}
            raise Divergence(f"solution lost at {self.time:.4f} s: {limit}", state)

    def set_motion(self, velocity: Array, angular_velocity: Array) -> None:
        """Let the torso move: (3,) m/s in odom, (3,) rad/s in base_link."""
        self.state.velocity[:] = velocity
        self.state.rate[:] = angular_velocity

    @property
    def nodes(self) -> Array:
        """(4, 2, 3) m in odom: clamp and foot, which is what touches the floor or hangs lowest."""
        node = self.state.node[:, 0]
        angle = self.state.tendon_angle - self.model.fault[0] / self.robot.tendon.spool_radius
        hanging = np.interp(self.model.fault[1] * angle, *self._reach)
        down = np.minimum(-node[:, 1], hanging)
        foot = self.robot.clamps + node[:, :1] * self.robot.outward - down[:, None] * [0, 0, 1]
        body = np.stack([self.robot.clamps, foot], axis=1)
        return np.asarray(self.state.position + body @ self.state.rotation.T)

    @property
    def ground_force(self) -> Array:
        """(4, 3) N in odom, of the floor on each foot, at the stage of the last step."""
        return self._feet.force.copy()


class _Need(NamedTuple):
    """A setting and what the table was made for."""

    name: str
    value: object
    needed: object


def _refuse(robot: Robot, scene: Scene) -> None:
    """Raise ConfigError at the first setting that the map's legs cannot follow."""
    floor, made_for = scene.floor, read_scene("flat").floor
    needs = (
        _Need("floor.height_map", floor.height_map, ""),
        _Need("floor.contact", floor.contact, made_for.contact),
        _Need("floor.stiffness", floor.stiffness, made_for.stiffness),
        _Need("floor.line_stiffness", floor.line_stiffness, made_for.line_stiffness),
        _Need("solver.halvings", scene.solver.halvings, 0),
        _Need("tendon.routing", robot.tendon.routing, "routed"),
    )
    for need in needs:
        if need.value != need.needed:
            raise ConfigError(
                f"{need.name} = {need.value!r}: legs of the model 'map' need {need.needed!r}"
            )


def map_legs(robot: Robot, table: LegTable) -> MapLegs:
    """The legs as numbers; raises ConfigError where the grid is not even or not from zero."""
    angle, height = table.angle, table.height
    for values in (angle, height):
        # Six digits are written.
        if len(values) < 2 or not np.allclose(np.diff(values, 2), 0.0, atol=1e-5):
            raise ConfigError("leg_map.csv: angles and heights must have even steps")
    if angle[0] != 0.0:
        raise ConfigError(f"leg_map.csv: the first angle is {angle[0]} rad, not zero")
    return MapLegs(
        table=np.ascontiguousarray(table.table),
        angle_step=angle[-1] / (len(angle) - 1),
        height_low=height[0],
        height_step=(height[-1] - height[0]) / (len(height) - 1),
        clamps=robot.clamps,
        outward=robot.outward,
        damping_time=robot.leg.damping_time,
    )


def _reach(table: LegTable) -> tuple[Array, Array]:
    """Angles (rad) and how far below its clamp a leg can touch there (m)."""
    carries = np.pad(table.table[:, :, 0] > 0.0, ((0, 0), (0, 1)))
    first = np.minimum(np.argmin(carries, axis=1), len(table.height) - 1)
    return table.angle, table.height[first]
