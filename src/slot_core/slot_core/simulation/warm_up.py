"""Compiles the kernels of a walk into the cache, so that no start waits for it; run by scripts/setup."""

import multiprocessing
from collections.abc import Callable
from typing import Any

from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.kernel_cache import KernelCache
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.simulation.rod_robot import RodRobot


def plant() -> None:
    """The robot on rods, as configured: constructors call every kernel that they need."""
    RodRobot(read_robot(), read_scene("flat"), read_servo())


def controller() -> None:
    """The controller, and the robot on tabulated legs."""
    ClosedLoop("map", "walk", None, 0)


def run(jobs: list[tuple[Callable[..., Any], tuple[str, ...]]]) -> None:
    """Call functions with their arguments in two processes, in the order given.

    Raises
    ------
    OSError
        If a kernel could not be kept.
    """
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        for result in [pool.apply_async(compile_with, job) for job in jobs]:
            result.get()


def compile_with(
    function: Callable[..., Any], arguments: tuple[str, ...]
) -> None:
    """Call a function whose kernels are to be kept."""
    function(*arguments)
    if KernelCache.lost:
        raise KernelCache.lost


def main() -> None:
    """Compile the kernels in two processes."""
    run([(plant, ()), (controller, ())])


if __name__ == "__main__":
    main()
