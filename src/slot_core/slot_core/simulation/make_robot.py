"""Simulated robot of a scene: choice of the model of its legs, and rest before time zero."""

import math
import pkgutil

import numpy as np

from slot_core.config import ConfigError
from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.matrices import norm, product
from slot_core.robot import LEGS, RobotParameters

MODELS = {
    "spatial": "slot_core.simulation.rod_robot:RodRobot",
    "map": "slot_core.legs.tabulated_robot:TabulatedRobot",
    "paper": "slot_paper.robot:PaperRobot",
}
"""Module and class of the simulated robot by the model of its legs."""
SPEED_AT_REST = 0.01  # m/s, of the torso; settled in config/scene: at most 4 mm/s, 0.14 m/s^2
ACCELERATION_AT_REST = 0.5  # m/s^2
SETTLE_PIECE, SETTLE_MAX = 0.1, 10.0  # s, of settling beyond `start.settle`


def make_robot(
    robot: RobotParameters, scene: Scene, servo: ServoSettings
) -> SimulatedRobot:
    """Simulated robot with the model of the legs `scene.solver.legs`, settled at its start.

    Raises ConfigError for legs that relax of another model than `spatial`.
    """
    if robot.leg.relaxes and scene.solver.legs != "spatial":
        raise ConfigError(
            f"leg.relaxation_share = {list(robot.leg.relaxation_share)}: legs of the model"
            f" {scene.solver.legs!r} cannot relax; those of 'spatial' can"
        )
    kind: type[SimulatedRobot] = pkgutil.resolve_name(MODELS[scene.solver.legs])
    return kind(robot, scene, servo)


def bring_to_rest(robot: SimulatedRobot) -> None:
    """Let a robot settle on until its torso rests; raises ConfigError if it does not.

    A robot that is stopped while it moves has an IMU that contradicts its odometry. With
    `start.settle` 0 s it starts in motion.
    """
    start, step = robot.scene.start, robot.scene.solver.step
    if not start.settle:
        return
    angle = np.full(len(LEGS), math.radians(start.tendon_angle_deg))
    for _ in range(round(SETTLE_MAX / SETTLE_PIECE)):
        turned = product(robot.rotation, robot.specific_force)
        acceleration = norm(turned + np.array(robot.scene.gravity))  # m/s^2
        speed = norm(robot.velocity)  # m/s
        if speed <= SPEED_AT_REST and acceleration <= ACCELERATION_AT_REST:
            robot.steps = 0
            return
        robot.advance(round(SETTLE_PIECE / step), angle)
    raise ConfigError(
        f"start.settle = {start.settle}: after {SETTLE_MAX:g} s more the torso still moves at"
        f" {1e3 * speed:.3g} mm/s, limit {1e3 * SPEED_AT_REST:g} mm/s, and"
        f" {acceleration:.3g} m/s^2, limit {ACCELERATION_AT_REST:g} m/s^2"
    )
