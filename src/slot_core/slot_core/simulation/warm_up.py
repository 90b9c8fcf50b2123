"""Compiles the kernels into the cache, so that no start waits for it; run by scripts/setup."""

import numpy as np

from slot_core.control.mpc.mpc import Mpc, read_mpc
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.rod_robot import RodRobot


def main() -> None:
    """Call every kernel of the simulation and of the configured MPC once."""
    robot = read_robot()
    sim = RodRobot(robot, read_scene("flat"), read_servo())
    sim.advance(1, np.zeros(4))
    _ = sim.nodes, sim.ground_force, sim.momentum(), sim.energy()
    Mpc(robot, read_mpc(), lambda: 0.0)


if __name__ == "__main__":
    main()
