"""Interface of a simulated robot, and base class of the robots on the compiled mechanics."""

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from slot_core.arrays import Array, Arrays, checked
from slot_core.config import ConfigError
from slot_core.dynamics.handle import Handle
from slot_core.dynamics.model import Model
from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.geometry import quaternion_of, rpy_of
from slot_core.refusal import quoted
from slot_core.robot import RobotParameters

SNAPSHOT = (
    "time",
    "halvings",
    "indefinite_steps",
    "position",
    "rotation",
    "velocity",
    "angular_velocity",
    "tendon_angle",
    "tendon_rate",
    "tension",
    "nodes",
)


def copy_of_state(name: str, text: str) -> Any:
    """Property with this text: a copy of an array of the robot's state."""
    return property(lambda robot: getattr(robot.state, name).copy(), doc=text)


def counted(index: int, text: str) -> Any:
    """Property with this text: a count of steps of the robot's kernels."""
    return property(lambda robot: int(robot._work.counter[index]), doc=text)


class SimulatedRobot(ABC):
    """A robot in a scene, advanced in steps of `scene.solver.step`, with any model of the legs.

    All arrays that are returned are copies; legs are in the order FL FR RL RR.
    """

    parameters: RobotParameters
    scene: Scene
    state: Any  # arrays that the model writes in place; the properties below return copies of them
    steps = 0  # since the end of settling
    halvings: Any = (
        0  # of a model that repeats or counts no steps, as `KernelRobot` does
    )
    indefinite_steps: Any = 0

    @abstractmethod
    def __init__(
        self, robot: RobotParameters, scene: Scene, servo: ServoSettings
    ) -> None:
        """Start at `scene.start` and settle; time zero is the end of settling."""

    @abstractmethod
    def advance(self, steps: int, command: Array) -> None:
        """Advance by `steps` steps with constant commanded tendon angles (4,), rad.

        Raises ValueError for a negative number of steps, a command of the wrong shape, not finite
        or outside [0, angle_max], and DivergenceError when a speed is not finite or exceeds the
        limit.
        """

    def push(self, force: Array, moment: Array) -> None:
        """Add an external force (3,), N, and moment (3,), N m, on the torso's centre, in odom.

        They act until their opposites are added. Raises ConfigError if the model of the legs does
        not support pushes.
        """
        raise ConfigError(
            f"legs of the model {self.scene.solver.legs!r} do not support pushes"
        )

    def snapshot(self) -> dict[str, Any]:
        """Copies of time, counters, motion, tendons and nodes, by property name (`SNAPSHOT`)."""
        return {name: getattr(self, name) for name in SNAPSHOT}

    @property
    def time(self) -> float:
        """Seconds since the end of settling."""
        return self.steps * self.scene.solver.step

    tendon_angle = copy_of_state(
        "tendon_angle", "(4,) rad, angle of the spools."
    )
    tendon_rate = copy_of_state(
        "tendon_rate", "(4,) rad/s, over the last step."
    )
    tension = copy_of_state("tension", "(4,) N, of the tendons.")

    @property
    @abstractmethod
    def nodes(self) -> Array:
        """(4, N, 3) m, nodes of the legs in odom, clamp first."""

    @property
    def directors(self) -> Array:
        """(4, N-1, 3) unit vectors along the width of the segments, to the right, in odom.

        (4, 0, 3) of legs that have no width: those from a table and those as published.
        """
        return np.zeros((4, 0, 3))

    @property
    @abstractmethod
    def ground_force(self) -> Array:
        """(4, 3) N in odom, force of the floor on each leg now."""

    @property
    def servo_torque(self) -> Array:
        """(4,) N m, load on the servos: tension times spool radius."""
        return self.tension * self.parameters.tendon.spool_radius

    position = copy_of_state("position", "(3,) m, torso's centre in odom.")
    rotation = copy_of_state("rotation", "(3, 3) base_link to odom.")
    velocity = copy_of_state("velocity", "(3,) m/s, torso's centre in odom.")
    angular_velocity = copy_of_state("rate", "(3,) rad/s, base_link.")
    specific_force = copy_of_state(
        "specific_force",
        "(3,) m/s^2, base_link: acceleration minus gravity at the centre, mean over a step.",
    )

    @property
    def quaternion(self) -> Array:
        """(4,) x y z w, base_link to odom, w >= 0."""
        return quaternion_of(self.state.rotation)

    @property
    def rpy(self) -> Array:
        """(3,) rad, roll pitch yaw about fixed x, y, z: R = R_z(yaw) R_y(pitch) R_x(roll)."""
        return rpy_of(self.state.rotation)

    def _settle(self) -> None:
        """Raises ConfigError for a start that the tendons do not reach."""
        start, most = self.scene.start, self.parameters.tendon.angle_max
        if math.radians(start.tendon_angle_deg) > most:
            raise ConfigError(
                f"start.tendon_angle_deg = {start.tendon_angle_deg:g}: above the largest angle of"
                f" the tendons, {math.degrees(most):g} deg"
            )
        command = np.full(4, math.radians(start.tendon_angle_deg))
        self.advance(round(start.settle / self.scene.solver.step), command)
        self.steps = 0

    def checked(self, command: Array) -> Array:
        """The command as an array (4,), rad; raises ValueError as `advance` does."""
        command = np.array(command, dtype=np.float64)
        limit = self.parameters.tendon.angle_max
        if command.shape != (4,):
            raise ValueError(f"command has the shape {command.shape}, not (4,)")
        if not all(0.0 <= angle <= limit for angle in command.tolist()):
            raise ValueError(
                f"command {command} rad is not inside [0, {limit:.6f}]"
            )
        return command


class KernelRobot(SimulatedRobot):
    """Robot whose kernels operate on a `Model`, a `MechanicalState` and a `Work`."""

    model: Model
    handle: Handle
    _work: Arrays

    def push(self, force: Array, moment: Array) -> None:
        """Add an external force (3,), N, and moment (3,), N m, on the torso's centre, in odom.

        They act until their opposites are added. Raises ValueError for another shape or a value
        that is not finite.
        """
        parts = (
            checked("push: force", force, (3,)),
            checked("push: moment", moment, (3,)),
        )
        self.model.push[:] += np.concatenate(parts)

    def set_motion(self, velocity: Array, angular_velocity: Array) -> None:
        """Set a rigid motion of the whole robot: (3,) m/s in odom, (3,) rad/s in base_link.

        Raises ValueError for other shapes, or values that are not finite.
        """
        velocity = checked("velocity", velocity, (3,))
        self.state.rate[:] = checked("angular velocity", angular_velocity, (3,))
        self.state.velocity[:] = velocity

    def damage_tendon(
        self, leg: int, slack: float = 0.0, broken: bool = False
    ) -> None:
        """Lengthen the tendon of leg 0 .. 3 by `slack` (m), negative: shorten it, or break it.

        Raises ValueError for another leg or a slack that is not finite.
        """
        if leg not in range(4):
            raise ValueError(f"leg {leg} must be 0 to 3")
        self.model.fault[:, leg] = (
            checked(f"slack of leg {leg}", slack, ()),
            not broken,
        )

    halvings = counted(
        0, "Number of times a step was repeated in pieces half as long."
    )
    indefinite_steps = counted(
        1,
        "Steps in which a pivot was not positive: a sign of a fold or of too large a step.",
    )

    @property
    def servo_torque(self) -> Array:
        """(4,) N m, load on the servos, with the friction of the guides against the spool's motion.

        A spool that stands still is taken to carry the load without friction.
        """
        rate, friction = self.state.tendon_rate, self.model.servo.friction
        share = np.where(
            rate > 0.0, friction, np.where(rate < 0.0, 1.0 / friction, 1.0)
        )
        return super().servo_torque * share


def require_steps(steps: int) -> None:
    """Raise ValueError for a number of steps that is no integer or negative."""
    if not isinstance(steps, (int, np.integer)) or steps < 0:
        raise ValueError(
            f"steps = {quoted(steps)}: expected an integer, 0 or more"
        )
