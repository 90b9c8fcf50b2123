"""Rigid torso on massless legs, each with the force of a leg at rest, from a table.

At tendon angle theta and drop eta (foot below clamp) a leg carries the force F(theta, eta) at
x(theta, eta) outward from the clamp, and its tendon the tension T(theta, eta). The table
`config/leg_map.csv` holds them for a leg on a frictionless floor. The foot is at
r = c + (x + xi) a + y b - eta k in base_link, with the clamp c, the axes a outward and b to the
left of the leg, and the vertical k of the torso; eta is such that r is on the floor, whose normal is
n. The displacements q = (xi, y, phi) of the foot, along the leg, sideways and its turn about n, are
those from the frictionless leg of the table. The material in contact shifts outward by x_theta per
angle and x_eta per drop; where the leg rolls they differ from the derivatives of x.
When the torso moves, n.dr = 0 gives
d eta = (n.(dp + dphi x r) + n.a (x_theta dtheta + dxi) + n.b dy) / D with D = n.k - n.a x_eta, and
the principle of virtual work, with friction f and its moment M n at r and m = x_eta a - k,

    N = (F + beta dF/dt + f.m) / D          normal force at r,
    S (q + beta dq/dt) = W^T (f.e_1, f.e_2, M / l) + (F + beta dF/dt) (n.a / D, n.b / D, 0),
    T' = T + beta dT/dt - x_theta (f + N n).a / r_spool.

S(theta, eta), 3 x 3, is the stiffness of a leg whose foot sticks (`slot_lab.leg_tests.leg_map`): a
foot that may turn leaves 17 of 96 N/m sideways at 90 deg and 64 mm. The foot touches the floor with
the two edges of its width, at r +- w b, each with half of N and Coulomb's law. With e_1, e_2 along
b x n and n x e_1 and the lever l = w |b x n| the slip of the foot is z = (v.e_1, v.e_2, l Omega), of
its shift v and its turn Omega on the floor; of the left and the right edge z_1 -+ z_3 and z_2. Over
the rates u = dq/dt

    z = s + W u,    W = ((w_a.e_1, w_b.e_1, 0), (w_a.e_2, w_b.e_2, 0), (0, 0, l)),
    w_a = a + (n.a / D) m,    w_b = b + (n.b / D) m.

The leg has no inertia, so q is a state of first order. With q + theta h u at the stage and edges of
drags d, whose friction over z is -(M z + g) with M = ((D_+, 0, D_-), (0, D_+, 0), (D_-, 0, D_+)),
D_+- = d_right +- d_left, the equation of q is linear in u,

    A u = (F + beta dF/dt) (n.a / D, n.b / D, 0) - S q - W^T (M s + g),
    A = S (theta h + beta) + W^T M W,

and stable for every S that is positive definite; g is held by bristles (`contact.py`). For the
torso the foot has the drag M - M W A^-1 W^T M over z. The drags depend on the slip and on N: they
are iterated. dF/dt omits the part of u in d eta, some mN.

beta is the Kelvin-Voigt time of the material: with stress E (e + beta de/dt) the force is
F + beta dF/dt wherever F is linear in the deformation. Where dF/deta is positive, at the fold of a
fully pulled leg that is high up, dF/dt omits the height, since it would feed energy to the motion.

Neglected: vibration of the legs (first frequency: 10 Hz hanging, 25 Hz standing); lifting of an edge
of the foot, and its roll; the forces q^2/2 dS/deta and q^2/2 dS/dtheta; the tilt of gravity in a
leg. The contact law is set as in the scene `flat`. Mass and inertia of the undeformed legs are added
to the torso, with the centre of mass at the torso's.

The table is interpolated bilinearly. Below the lowest and above the highest height, force and
tension are extrapolated linearly from the cell at the edge, down to zero; the other columns are
constant there. The table belongs to the robot of `config/robot.yaml`: after a change there run
`scripts/tune leg`.
"""

from operator import attrgetter

import numpy as np

from slot_core.arrays import Array, Arrays, zeros
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
    FEET,
    PLACE,
    TILT_MAX_DEG,
    TOO_TILTED,
    Feet,
    MapLegs,
    Mounts,
    Sides,
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
    "longitudinal_N_per_m",
    "sideways_N_per_m",
    "sideways_N_per_rad",
    "turn_N_m_per_rad",
)
# N/m, least stiffness along the leg: of a leg that hangs it is some N/m
ALONG_MIN = 300.0
# The stiffness of a turn is more than S_yp^2 / S_yy by a factor and a least part (N m/rad): a leg
# that is pressed down by 11 N or more is unstable sideways where its foot may turn.
TURN_MARGIN, TURN_MIN = 1.02, 0.02
SPRINGS = slice(5, 9)  # columns of the stiffness over the foot's displacements


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
        # the torso carries the mass of the legs
        self.model = model._replace(
            torso=model.torso._replace(mass=robot.mass, inertia=robot.inertia)
        )
        self.legs = map_legs(robot, table, model.floor.half_width)
        self._contact_drop = _contact_drop(table)
        self.state = state_space(2, 2)
        self.state.position[2] = scene.start.height
        self.state.rotation[:] = np.eye(3)
        self.state.node[:, PLACE] = (
            table.table[0, -1, 1],
            0.0,
            -scene.start.height,
        )
        self.feet, self._work = feet_space(), work_space()
        self.handle = self.handle_of(self.state, self.feet, self._work)
        self._settle()

    def handle_of(self, state: Arrays, feet: Arrays, work: Arrays) -> Handle:
        """Arguments of the kernels for variables of this robot."""
        scheme = build_scheme(self.scene.solver, self.model.floor)
        model, legs = self.model, self.legs
        sides: Arrays = (
            [
                legs.clamps,
                legs.outward,
                legs.left,
                model.friction.T,
                model.fault.T,
            ],
            [
                getattr(state if name in state._fields else feet, name)
                for name in Sides._fields
            ],
        )
        if state.buffer.ndim == 1:  # views, where the legs are last in memory
            sides = tuple(
                [
                    np.ascontiguousarray(np.moveaxis(rows, 0, -1))[None]
                    for rows in part
                ]
                for part in sides
            )
        sides = Mounts(*sides[0]), Sides(*sides[1])
        return Handle((model, legs, state, feet, work, scheme, sides))

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
            raise DivergenceError(
                f"simulation diverged at {self.time:.4f} s: {limit}",
                self.snapshot() | {"command": self.feet.command.copy()},
            )

    @property
    def nodes(self) -> Array:
        """(4, 2, 3) m in odom: clamp and foot, in contact or the lowest point of the leg."""
        node = self.state.node[:, PLACE]
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
        return Transform(self.rotation, self.position).apply(
            np.stack([self.parameters.clamps, foot], axis=1)
        )

    @property
    def ground_force(self) -> Array:
        """(4, 3) N in odom, force of the floor on each foot, at the stage of the last step."""
        return self.feet.force.copy()


def feet_space(lanes: tuple[int, ...] = ()) -> Arrays:
    """Variables of the feet, zero; of four states with the axis `lanes` = (4,)."""
    return Feet(
        **{
            name: np.moveaxis(values, -1 - len(lanes), 0)
            for name, values in zeros(FEET, lanes).items()
        }
    )


def _require_tabulated(scene: Scene) -> None:
    """Raise ConfigError at the first setting that the table does not cover."""
    made_for = read_scene("flat").floor
    for name, needed in {
        "floor.height_map": "",
        "floor.contact": made_for.contact,
        "floor.stiffness": made_for.stiffness,
        "floor.line_stiffness": made_for.line_stiffness,
        "solver.halvings": 0,
    }.items():
        value = attrgetter(name)(scene)
        if value != needed:
            raise ConfigError(
                f"{name} = {quoted(value)}: legs of the model 'map' need {needed!r}"
            )


def map_legs(
    robot: RobotParameters, table: LegTable, half_width: float
) -> MapLegs:
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
    columns = table.table.copy()
    along, sideways, coupled, turn = np.moveaxis(columns[..., SPRINGS], -1, 0)
    along[:] = np.maximum(along, ALONG_MIN)
    held = coupled * coupled / sideways
    turn[:] = np.maximum(turn, TURN_MARGIN * held + TURN_MIN)
    return MapLegs(
        table=columns,
        angle_step=angle[-1] / (len(angle) - 1),
        height_low=height[0],
        height_step=(height[-1] - height[0]) / (len(height) - 1),
        clamps=robot.clamps,
        outward=robot.outward,
        left=-robot.rightward,
        half_width=half_width,
        damping_time=robot.leg.damping_time,
    )


def _contact_drop(table: LegTable) -> tuple[Array, Array]:
    """Tendon angles (rad) of the table and the largest drop with contact at each (m)."""
    carries = np.pad(table.table[:, :, 0] > 0.0, ((0, 0), (0, 1)))
    first = np.minimum(np.argmin(carries, axis=1), len(table.height) - 1)
    return table.angle, table.height[first]
