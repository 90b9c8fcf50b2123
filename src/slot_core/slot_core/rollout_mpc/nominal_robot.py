"""Nominal robot: the simulated robot on tabulated legs, rolled out from any state.

It is the robot of `legs/tabulated_robot.py` on a flat floor at long steps. Its legs have no
mass. Its state is the torso's, which the state estimator gives, and the state of legs and servos,
which follows from the commands: tendon angles, servo loops, and the feet's displacements. A state
is the buffer (m,) of `dynamics/model.py`.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slot_core import config
from slot_core.arrays import Array, checked
from slot_core.compiled import helper, kernel
from slot_core.dynamics.handle import contents
from slot_core.dynamics.lanes import COUNT, in_lanes, like, where
from slot_core.dynamics.model import state_space, work_space
from slot_core.dynamics.scene import (
    NO_SENSORS,
    Scene,
    level_changes,
    read_scene,
)
from slot_core.dynamics.servo import read_servo
from slot_core.elementary import atan2
from slot_core.geometry import matrix_of_rpy, roll_pitch_yaw, rotate
from slot_core.key_frame import StateParts
from slot_core.legs.tabulated_kernels import (
    COS_TILT_MAX,
    PLACE,
    is_slow,
    one_step,
)
from slot_core.legs.tabulated_robot import (
    COLUMNS,
    SPRINGS,
    TabulatedRobot,
    feet_space,
)
from slot_core.matrices import product
from slot_core.robot import LEGS, RobotParameters
from slot_core.rollout_mpc.settings import NominalSettings

RECORD = 30  # numbers of a stage: pose, forces on the feet, places of the feet
# stages in which legs and servos come to rest at a constant command
SETTLING = 10
# columns of the leg table that are proportional to the legs' stiffness
SCALED = [column for column, name in enumerate(COLUMNS) if "N" in name]


class Rollouts(NamedTuple):
    """Motion of P plans over the stages 1 .. n; NaN from a divergence on."""

    pose: Array  # (P, n, 6) roll, pitch, yaw (rad), x, y, z (m), odom
    force: Array  # (P, n, 4, 3) N, of the floor on the feet, odom
    foot: Array  # (P, n, 4, 3) m, places of the feet, odom


class NominalRobot:
    """Rollouts of plans of tendon angles; it knows no payload, slope or damage but the wrench."""

    STATE = StateParts("push", "stiffness", "gravity", "friction", "in_posture")

    def __init__(
        self, robot: RobotParameters, settings: NominalSettings, dt: float
    ):
        """Build the model; dt: s between stages. Raises ConfigError as the simulated robot does."""
        self._cycles, self._steps = settings.cycles, settings.steps
        scene = nominal_scene(settings, dt / (settings.cycles * settings.steps))
        width = settings.width * robot.leg.contact_width
        feet = replace(robot, leg=replace(robot.leg, contact_width=width))
        self.robot = TabulatedRobot(feet, scene, read_servo())
        along, aside, turn = settings.springs
        self.robot.legs.table[..., SPRINGS] *= (along, aside, 1.0, turn)
        self._table = self.robot.legs.table.copy()
        self._stiffness = 1.0
        self.friction = settings.friction  # of the floor
        self.in_posture = False  # on a level floor, where the feet slip earlier
        self._posture_friction = settings.posture_friction
        self.push = np.zeros(6)  # N, N m, force and moment on the torso
        self._angle_max = robot.tendon.angle_max
        self._initial = self.robot.state.buffer.copy()
        self._four = self.robot.handle_of(  # robots side by side
            state_space(2, 2, lanes=(COUNT,)),
            feet_space((COUNT,)),
            work_space((COUNT,)),
        )
        # compile the kernels
        self.measured(self._initial, np.zeros(12))
        self.roll_out(self._initial, np.zeros((1 + COUNT, 2, len(LEGS))))

    @property
    def gravity(self) -> Array:
        """Gravity (3,), m/s^2, in the frame of the states; raises ValueError for other shapes."""
        return np.array(self.robot.model.gravity)

    @gravity.setter
    def gravity(self, gravity: Array) -> None:
        self.robot.model.gravity[:] = checked("gravity", gravity, (3,))

    @property
    def stiffness(self) -> float:
        """Ratio kappa of the legs (`legs/leg_table.py`)."""
        return self._stiffness

    @stiffness.setter
    def stiffness(self, ratio: float) -> None:
        self._stiffness = ratio
        self.robot.legs.table[..., SCALED] = ratio * self._table[..., SCALED]

    def set_wrench(self, wrench: Array, yaw: float) -> None:
        """Set the wrench on the torso: F_z (N) in odom, M_x and M_y (N m) at heading `yaw`."""
        wrench = checked("wrench", wrench, (3,))
        moment = rotate(wrench[1:], float(checked("yaw", yaw, ())))
        self.push = np.array([0.0, 0.0, wrench[0], *moment, 0.0])

    def at_rest(self, state: Array, angle: Array) -> Array:
        """State with the torso of `state` (12,) and legs and servos that have reached `angle`."""
        state = checked("state", state, (12,))
        angle = checked("angle", angle, (len(LEGS),))
        self.robot.state.buffer[:] = self._initial
        self.robot.state.tendon_angle[:] = angle
        still = np.concatenate([state[:6], np.zeros(6)])
        start = self.measured(self.robot.state.buffer.copy(), still)
        settled = self.after(start, np.tile(angle, (SETTLING + 1, 1)))
        return self.measured(settled, state)

    def measured(self, known: Array, state: Array) -> Array:
        """The state with the torso of an estimate (12,) and the legs and servos of `known`."""
        torso, state = self.robot.state, checked("state", state, (12,))
        torso.buffer[:] = self._checked(known)
        torso.rotation[:] = matrix_of_rpy(state[:3])
        torso.position[:], torso.velocity[:] = state[3:6], state[9:]
        torso.rate[:] = product(torso.rotation.T, state[6:9])
        return torso.buffer.copy()

    def place(self, start: Array) -> Array:
        """Place (3,) of the torso in odom: x, y (m), yaw (rad)."""
        torso = self.robot.state
        torso.buffer[:] = self._checked(start)
        (x, y, _), turned = torso.position, torso.rotation
        return np.array([x, y, atan2(turned[1, 0], turned[0, 0])])

    def roll_out(self, start: Array, plans: Array) -> Rollouts:
        """Simulate plans (P, n + 1, 4), rad at the stages 0 .. n, from one state.

        A plan that is not finite diverges. All methods raise ValueError for other shapes.
        """
        plans = checked("plans", plans, (-1, -1, len(LEGS)), finite=False)
        if plans.shape[1] < 2:
            raise ValueError(
                f"plans: {plans.shape[1]} stages, expected two or more"
            )
        start = self._checked(start)
        self.robot.model.push[:] = self.push
        self.robot.model.friction[:] = (
            min(self.friction, self._posture_friction)
            if self.in_posture
            else self.friction
        )
        count, stages = plans.shape[0], plans.shape[1] - 1
        found = np.empty((count, stages, RECORD))
        roll_out(
            self.robot.handle,
            self._four,
            start,
            plans,
            self._angle_max,
            self._cycles,
            self._steps,
            found,
            np.empty((stages + 1, len(LEGS), COUNT)),
            np.empty((stages, RECORD, COUNT)),
        )
        vectors = found[..., 6:].reshape(count, stages, 2, len(LEGS), 3)
        return Rollouts(found[..., :6], vectors[:, :, 0], vectors[:, :, 1])

    def after(self, start: Array, plan: Array) -> Array:
        """State after a plan (n + 1, 4)."""
        self.roll_out(start, np.asarray(plan)[None])
        return self.robot.state.buffer.copy()

    def _checked(self, state: Array) -> Array:
        """The state, if it is one of this robot; it may have diverged. Raises ValueError."""
        return checked(
            "start", state, self.robot.state.buffer.shape, finite=False
        )


def nominal_scene(settings: NominalSettings, step: float) -> Scene:
    """The flat floor, with the solver of tabulated legs at another step and no sensors."""
    friction = [settings.friction] * len(LEGS)
    changes = {
        **level_changes("map"),
        **NO_SENSORS,
        "solver.step": step,
        "solver.iterations": settings.iterations,
        "floor.friction": friction,
        "floor.friction_other": friction,
        "tendons.broken": settings.broken,
    }
    return config.replace(read_scene("flat"), changes, "rollout_mpc")


@kernel
def roll_out(
    machine,
    machines,
    start,
    plans,
    angle_max,
    cycles,
    steps,
    found,
    plan,
    written,
):
    """Simulate every plan from the state `start` (m,).

    machine, machines: handles of a robot and of four side by side. plans: (P, n + 1, 4) rad, tendon
    angles at the stages 0 .. n, linear between them; the servos get them `cycles` times a stage, each
    time for `steps` steps. Writes found (P, n, RECORD) at the stages 1 .. n, in odom: roll, pitch, yaw
    (rad), x, y, z (m), force of the floor on the feet (4, 3), N, and their places (4, 3), m; they are
    NaN from a divergence on. The state after the last plan that was simulated alone stays. Used too:
    plan (n + 1, 4, 4), written (n, RECORD, 4).
    """
    model, legs, state, feet, work, scheme, sides = contents(machine)
    one = model, legs, state, feet, work, scheme, in_lanes(sides)
    alone = plans.shape[0] % COUNT
    for p in range(alone):
        _follow(one, start, (angle_max, cycles, steps), plans[p], found[p])
    model, legs, state, feet, work, scheme, sides = contents(machines)
    four = (
        model,
        legs,
        in_lanes(state),
        in_lanes(feet),
        in_lanes(work),
        scheme,
        (sides[0], in_lanes(sides[1])),
    )
    # the others four at a time, which takes less than three alone
    for p in range(alone, plans.shape[0], COUNT):
        for k, i in np.ndindex(plan.shape[:2]):
            for c in range(COUNT):
                plan[k, i, c] = plans[p + c, k, i]
        _follow(
            four,
            start,
            (angle_max, cycles, steps),
            in_lanes(plan),
            in_lanes(written),
        )
        for c in range(COUNT):
            for k in range(written.shape[0]):
                for i in range(RECORD):
                    found[p + c, k, i] = written[k, i, c]


@helper
def _follow(machine, start, settings, plan, found):
    """Simulate a plan, or four in lanes; the velocity of a robot that diverges becomes NaN."""
    model, legs, state, feet, work, scheme, sides = machine
    angle_max, cycles, steps = settings
    for i in range(start.size):
        state.buffer[i] = start[i]
    for k in range(plan.shape[0] - 1):
        for c in range(cycles):
            for leg in range(4):
                here, there = plan[k, leg], plan[k + 1, leg]
                goal = here + c / cycles * (there - here)
                feet.command[leg] = min(max(goal, 0.0), angle_max)
            for _ in range(steps):
                one_step(model, legs, state, feet, work, scheme, sides)
                sound = is_slow(state, model.speed_limit) & (
                    state.rotation[2, 2] > COS_TILT_MAX
                )
                v_x = state.velocity[0]
                state.velocity[0] = where(sound, v_x, like(math.nan, v_x))
        _record(found[k], legs, state, feet)


@helper
def _record(found, legs, state, feet):
    """Write pose, forces and places of the feet, or NaN for a velocity that is NaN."""
    r, none = state.rotation, 0.0 * state.velocity[0]
    found[0], found[1], found[2] = roll_pitch_yaw(r)
    for i in range(3):
        found[i] += none
        found[3 + i] = state.position[i] + none
    for leg in range(4):
        c, a, b, node = (
            legs.clamps[leg],
            legs.outward[leg],
            legs.left[leg],
            state.node[leg, PLACE],
        )
        x, y, z = (
            c[0] + node[0] * a[0] + node[1] * b[0],
            c[1] + node[0] * a[1] + node[1] * b[1],
            c[2] + node[0] * a[2] + node[1] * b[2] + node[2],
        )
        for i in range(3):
            place = state.position[i] + r[i, 0] * x + r[i, 1] * y + r[i, 2] * z
            found[18 + 3 * leg + i] = place + none
            found[6 + 3 * leg + i] = feet.force[leg, i] + none
