"""Process for test_rod_robot.py: prints the kernels that a walk is the first to call.

usage: late_kernels.py warm_up | robot | servos SCENE
    warm_up   those that the walk or its start call after scripts/setup has compiled the kernels
    robot     those that the walk calls after its start
    servos    the same with the supervisor and emulated servos
"""

import sys
from collections import deque

from numba.core.dispatcher import Dispatcher

from slot_core.simulation import warm_up
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.simulation.supervised_loop import SupervisedLoop

TICKS = 12  # a third of a stride; every stage of the controller answers in each tick
SECONDS = 1.0  # the robot walks since 0.34 s


def loaded():
    """Every kernel of the project with the types of arguments for which it is compiled."""
    modules = [
        m for name, m in sys.modules.items() if name.startswith("slot_core.")
    ]
    values = [
        v
        for module in modules
        for v in vars(module).values()
        if isinstance(v, Dispatcher)
    ]
    return {
        (f"{v.__module__}.{v.__name__}", types)
        for v in values
        for types in v.signatures
    }


def main(what, scene):
    if what == "warm_up":
        warm_up.plant()
        warm_up.controller()
        before = loaded()
    if what == "servos":
        walk = SupervisedLoop(scene, "walk", None, 0, hardware="fake_bus").run(
            SECONDS
        )
    else:
        walk = ClosedLoop(scene, "walk", None, 0).run(TICKS)
    if what != "warm_up":
        before = loaded()
    deque(walk, maxlen=0)
    assert before
    for name, types in sorted(loaded() - before, key=str):
        print(f"{name}{types}"[:300])


if __name__ == "__main__":
    main(*sys.argv[1:])
