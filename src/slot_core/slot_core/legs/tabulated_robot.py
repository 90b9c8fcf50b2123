"""Rigid torso on massless legs, each with the force of a leg at rest, from a table.

At tendon angle theta and drop eta (foot below clamp) a leg carries the force F(theta, eta) at
x(theta, eta) outward from the clamp, and its tendon the tension T(theta, eta). The table
`config/leg_map.csv` holds them for a leg on a frictionless floor. The foot is at
r = c + x a + y b - eta k in base_link, with the clamp c, the axes a outward and b to the left of
the leg, the vertical k of the torso, and the foot's displacement y out of the leg's plane; eta is
such that r is on the floor, whose normal is n. The material in contact shifts outward by x_theta
per angle and x_eta per drop; where the leg rolls they differ from the derivatives of x.
When the torso moves, n.dr = 0 gives
d eta = (n.(dp + dphi x r) + n.a x_theta dtheta + n.b dy) / D with D = n.k - n.a x_eta, and the
principle of virtual work, with friction f at r and m = x_eta a - k,

    N = (F + beta dF/dt + f.m) / D          normal force at r,
    k_y (y + beta dy/dt) = f.w + (F + beta dF/dt) n.b / D,      w = b + (n.b / D) m,
    T' = T + beta dT/dt - x_theta (f.a + (F + beta dF/dt + f.m) n.a / D) / r_spool.

k_y(theta, eta) is the stiffness sideways of a leg whose foot sticks, from the table too; the leg
has no inertia, so y is a state of first order. With y + theta h dy/dt at the stage, and friction
f = -drag (s + w dy/dt) - f_0 at the slip s without dy/dt, its equation is linear in dy/dt,

    (k_y (theta h + beta) + drag w.w) dy/dt = (F + beta dF/dt) n.b / D - f_0.w - drag s.w - k_y y,

and stable for every k_y. The drag depends on the slip and on N: they are iterated. dF/dt omits
the part of dy/dt in d eta, some mN.

beta is the Kelvin-Voigt time of the material: with stress E (e + beta de/dt) the force is
F + beta dF/dt wherever F is linear in the deformation. Where dF/deta is positive, at the fold of a
fully pulled leg that is high up, dF/dt omits the height, since it would feed energy to the motion.

Neglected: vibration of the legs (first frequency: 10 Hz hanging, 25 Hz standing); the effect of
friction on the shape of a leg beyond the path of its foot, along the leg (where it carries load
below 80 mm its stiffness there is 1 to 20 N/mm); slip and lifting of an edge of the foot, which
turns it in its place after 1 to 4 mm, so that at 10 mm a leg has some 0.4 of the force k_y y; the
force y^2/2 dk_y/deta, some 0.1 N at 10 mm; the tilt of gravity in a leg. The contact law is set as in the
scene `flat`. Mass and inertia of the undeformed legs are added to the torso, with the centre of
mass at the torso's.

The table is interpolated bilinearly. Below the lowest and above the highest height, force and
tension are extrapolated linearly from the cell at the edge, down to zero; the other columns are
constant there. The table belongs to the robot of `config/robot.yaml`: after a change there run
`scripts/calibrate --leg-map`.
"""

from operator import attrgetter

import numpy as np

from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.dynamics.handle import Handle
from slot_core.dynamics.model import (
    build_model,
    build_scheme,
    state_space,
    work_space,
)
from slot_core.dynamics.scene import Scene, read_scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamics.simulated_robot import KernelRobot, require_steps
from slot_core.geometry import Transform
from slot_core.legs.leg_table import LegTable, read_leg_table
from slot_core.legs.tabulated_kernels import (
    TILT_MAX_DEG,
    TOO_TILTED,
    Feet,
    MapLegs,
    advance,
)
from slot_core.matrices import interpolated
from slot_core.refusal import DivergenceError, quoted
from slot_core.robot import RobotParameters

COLUMNS = (
    "force_N",
    "contact_x_m",
    "tension_N",
    "foot_m_per_rad",
    "foot_m_per_m",
    "sideways_N_per_m",
)


class TabulatedRobot(KernelRobot):
    """The robot with legs from a table.

    Raises ConfigError, which names the setting, for a scene that the table does not cover:
    an uneven floor, another stiffness of the floor, contact of the tips alone, halved steps. A torso
    tilted by more than 60 deg is a DivergenceError, because the legs touch only a floor below it.
    """

    def __init__(
        self, robot: RobotParameters, scene: Scene, servo: ServoSettings
    ) -> None:
        _require_tabulated(scene)
        self.parameters, self.scene = robot, scene
        table = read_leg_table(COLUMNS)
        model = build_model(robot, scene, servo)
        # The torso carries the mass of the legs. Their feet are the tips' both edges in one point.
        rigid_body, floor = model.torso, model.floor
        rigid_body = rigid_body._replace(mass=robot.mass, inertia=robot.inertia)
        foot = 2 * floor.stiffness[-1:], 2 * floor.damping[-1:]
        floor = floor._replace(stiffness=foot[0], damping=foot[1])
        self.model = model._replace(torso=rigid_body, floor=floor)
        self.legs = map_legs(robot, table)
        self._contact_drop = _contact_drop(table)
        self.state = state_space(1, 1)
        self.state.position[2] = scene.start.height
        self.state.rotation[:] = np.eye(3)
        self.state.node[:, 0] = table.table[0, -1, 1], 0.0, -scene.start.height
        self.feet = Feet(*(np.zeros(shape) for shape in (4, (4, 3), 4, 4, 2)))
        self._work = work_space()
        parts = (self.model, self.legs, self.state, self.feet, self._work)
        self.handle = Handle(
            (*parts, build_scheme(scene.solver, self.model.floor))
        )
        self._settle()

    def advance(self, steps: int, command: Array) -> None:
        """Advance by `steps` steps with constant commanded tendon angles (4,), rad.

        Raises ValueError for a negative number of steps, a command of the wrong shape, not finite
        or outside [0, angle_max], and DivergenceError when a speed is not finite or exceeds
        `scene.solver.speed_limit`, or the tilt of the torso exceeds 60 deg.
        """
        require_steps(steps)
        self.feet.command[:] = self.checked(command)
        done, divergence = advance(self.handle, steps)
        self.steps += done
        if divergence >= 0:
            limit = f"torso is beyond {self.scene.solver.speed_limit} m/s or not a number"
            if divergence == TOO_TILTED:
                limit = f"torso is tilted by more than {TILT_MAX_DEG:g} deg"
            state = self.snapshot() | {"command": self.feet.command.copy()}
            raise DivergenceError(
                f"simulation diverged at {self.time:.4f} s: {limit}", state
            )

    @property
    def nodes(self) -> Array:
        """(4, 2, 3) m in odom: clamp and foot, in contact or the lowest point of the leg."""
        node = self.state.node[:, 0]
        angle = (
            self.state.tendon_angle
            - self.model.fault[0] / self.parameters.tendon.spool_radius
        )
        hanging = interpolated(self.model.fault[1] * angle, *self._contact_drop)
        down = np.minimum(-node[:, 2], hanging)
        foot = self.parameters.clamps - down[:, None] * [0, 0, 1]
        foot += (
            node[:, :1] * self.parameters.outward
            + node[:, 1:2] * self.legs.left
        )
        body = np.stack([self.parameters.clamps, foot], axis=1)
        return Transform(self.rotation, self.position).apply(body)

    @property
    def ground_force(self) -> Array:
        """(4, 3) N in odom, force of the floor on each foot, at the stage of the last step."""
        return self.feet.force.copy()


def _require_tabulated(scene: Scene) -> None:
    """Raise ConfigError at the first setting that the table does not cover."""
    made_for = read_scene("flat").floor
    needs = {
        "floor.height_map": "",
        "floor.contact": made_for.contact,
        "floor.stiffness": made_for.stiffness,
        "floor.line_stiffness": made_for.line_stiffness,
        "solver.halvings": 0,
    }
    for name, needed in needs.items():
        value = attrgetter(name)(scene)
        if value != needed:
            raise ConfigError(
                f"{name} = {quoted(value)}: legs of the model 'map' need {needed!r}"
            )


def map_legs(robot: RobotParameters, table: LegTable) -> MapLegs:
    """Parameters of the legs; raises ConfigError for an uneven grid or one not from zero."""
    angle, height = table.angle, table.height
    for values in (angle, height):
        # The table is written with six digits.
        if len(values) < 2 or not np.allclose(
            np.diff(values, 2), 0.0, atol=1e-5
        ):
            raise ConfigError(
                "leg_map.csv: angles and heights must have even steps"
            )
    if angle[0] != 0.0:
        raise ConfigError(
            f"leg_map.csv: the first angle is {angle[0]} rad, not zero"
        )
    return MapLegs(
        table=np.ascontiguousarray(table.table),
        angle_step=angle[-1] / (len(angle) - 1),
        height_low=height[0],
        height_step=(height[-1] - height[0]) / (len(height) - 1),
        clamps=robot.clamps,
        outward=robot.outward,
        left=-robot.rightward,
        damping_time=robot.leg.damping_time,
    )


def _contact_drop(table: LegTable) -> tuple[Array, Array]:
    """Tendon angles (rad) of the table and the largest drop with contact at each (m)."""
    carries = np.pad(table.table[:, :, 0] > 0.0, ((0, 0), (0, 1)))
    first = np.minimum(np.argmin(carries, axis=1), len(table.height) - 1)
    return table.angle, table.height[first]
