"""Compiles the kernels into the cache, so that no start waits for it; run by scripts/setup."""

from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.simulation.rod_robot import RodRobot


def main() -> None:
    """Build the nodes' cores as configured: their constructors call every kernel that they need."""
    ClosedLoop("flat", "walk", None, 0)
    sim = RodRobot(read_robot(), read_scene("flat"), read_servo())
    _ = sim.momentum(), sim.energy()  # for tests and benchmarks


if __name__ == "__main__":
    main()
