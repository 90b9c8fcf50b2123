"""Simulated robots that several tests use.

Steps of a robot on rods with one leg after the other: the same equations in numbers, slower.
"""

import numpy as np

from slot_core import config
from slot_core.compiled import kernel
from slot_core.dynamics.handle import Handle, contents
from slot_core.dynamics.integrator import advance_contents
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.servos.registry import read_brand
from slot_core.simulation.plant import RobotSimulator
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


def plant(scene, servo=None, seed=0, *, bus=False):
    """Simulator of the robot in a scene with its sensors; bus: on emulated servos."""
    emulate = read_brand().emulate if bus else None
    rng = np.random.default_rng(seed)
    return RobotSimulator(ROBOT, scene, servo or read_servo(), rng, emulate)


def advance_one_by_one(sim, steps):
    """As `integrator.advance` of a robot's handle."""
    *parts, legs, scheme = sim.handle._content
    singly = tuple(of_leg(legs, leg) for leg in range(4))
    return _advance(Handle((*parts, singly, scheme)), steps)


def of_leg(legs, leg):
    """Views of the arrays of one leg, which those of four have as their last axis."""
    if isinstance(legs, tuple):
        return type(legs)(*(of_leg(part, leg) for part in legs))
    return legs[..., leg]


@kernel
def _advance(machine, steps):
    model, state, work, start, legs, scheme = contents(machine)
    return advance_contents(model, state, work, start, legs, scheme, steps)
