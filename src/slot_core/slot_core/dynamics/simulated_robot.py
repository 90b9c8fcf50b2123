"""What software may ask of a simulated robot, whatever its model."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from slot_core.dynamics.scene import Scene
from slot_core.dynamics.simulator import quaternion
from slot_core.robot import Array, Robot


class RobotState(Protocol):
    """Motion of torso and tendons that every model keeps, as arrays it writes in place."""

    @property
    def position(self) -> Array:
        """(3,) m, torso's centre in odom."""

    @property
    def rotation(self) -> Array:
        """(3, 3) base_link to odom."""

    @property
    def velocity(self) -> Array:
        """(3,) m/s, odom."""

    @property
    def rate(self) -> Array:
        """(3,) rad/s, base_link."""

    @property
    def specific_force(self) -> Array:
        """(3,) m/s^2, base_link, mean over the last step."""


class SimulatedRobot:
    """Readings of a robot's torso and the check of its command; all arrays returned are copies."""

    robot: Robot
    scene: Scene
    state: RobotState

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

    def checked(self, command: Array) -> Array:
        """The command as `advance` takes it; raises ValueError as it does."""
        command = np.array(command, dtype=np.float64)
        limit = self.robot.tendon.angle_max
        if command.shape != (4,):
            raise ValueError(f"command has the shape {command.shape}, not (4,)")
        if not all(0.0 <= angle <= limit for angle in command.tolist()):
            raise ValueError(f"command {command} rad is not inside [0, {limit:.6f}]")
        return command
