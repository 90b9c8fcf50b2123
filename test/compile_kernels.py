"""Compiles the kernels that tests call and a walk does not; run by scripts/test.

So no test's time limit holds a compilation, and the workers do not compile the same kernel twice.
"""

import time

import numpy as np
from rod_robots import advance_one_by_one

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.legs.tabulated_robot import TabulatedRobot
from slot_core.mpc.force_mpc import ForceMpc
from slot_core.mpc.settings import read_mpc
from slot_core.robot import read_robot
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import Geometry, Material, Rectangle
from slot_core.simulation import warm_up
from slot_core.simulation.many_robots import ManyRobots
from slot_core.simulation.rod_robot import RodRobot
from slot_lab.leg_tests.held_leg import HeldLeg

ROBOT, SERVO, NO_STEP = read_robot(), read_servo(), 0
FLAT, MAP = (
    config.replace(read_scene(name), {"start.settle": 0.0})
    for name in ("flat", "map")
)


def compile_robot():
    """A robot on rods, in lanes and leg by leg."""
    rods = RodRobot(ROBOT, FLAT, SERVO)
    rods.snapshot()
    advance_one_by_one(rods, NO_STEP)


def compile_many(kind, scene):
    """Many robots with a model of the legs."""
    many = ManyRobots([kind(ROBOT, scene, SERVO)])
    many.advance(np.zeros((1, 1, 4)), NO_STEP)


def compile_others():
    """A leg with friction at a held clamp, the public rod, and the solver of forces."""
    HeldLeg(ROBOT, 4, 0.0, 0.2).pull(0.01, 1.0)
    rod = CosseratRod(
        Material(1e7, 3e6, 1200.0, 0.0),
        Geometry(0.2, Rectangle(0.02, (0.01, 0.01))),
    )
    rod.state = rod.state
    rod.run(1e-3, NO_STEP)
    rod.solve_static()
    _ = rod.energy(), rod.tangent()
    ForceMpc(ROBOT, read_mpc(), time.perf_counter)


if __name__ == "__main__":
    many = [
        (compile_many, (RodRobot, FLAT)),
        (compile_many, (TabulatedRobot, MAP)),
    ]
    warm_up.run([(compile_robot, ()), *many, (compile_others, ())])
