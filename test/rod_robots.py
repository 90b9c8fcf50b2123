"""Robots on rods that several tests use."""

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.rod_robot import RodRobot

ROBOT = read_robot()
UNDAMPED = config.replace(
    ROBOT, {"leg.damping_time": 0.0, "tendon.cable_damping": 0.0}
)
FLOATING = {
    "gravity": [0.0, 0.0, 0.0],
    "start__height": 5.0,
    "start__settle": 0.0,
}


def simulator(robot=ROBOT, servo="torque_speed", **changes):
    """A robot in the scene `flat` with changes: solver__step is solver.step.

    servo: model, or changes of its settings.
    """
    changes = {
        name.replace("__", "."): value for name, value in changes.items()
    }
    scene = config.replace(read_scene("flat"), changes)
    settings = {"model": servo} if isinstance(servo, str) else servo
    return RodRobot(robot, scene, config.replace(read_servo(), settings))
