"""Compiles the kernels into the cache; scripts/setup runs it, so that no start has to wait."""

import numpy as np

from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.simulator import Simulator
from slot_core.robot import read_robot


def main() -> None:
    """Use everything that a simulation uses, once."""
    sim = Simulator(read_robot(), read_scene("flat"), read_servo())
    sim.advance(1, np.zeros(4))
    _ = sim.nodes, sim.ground_force, sim.momentum(), sim.energy()


if __name__ == "__main__":
    main()
