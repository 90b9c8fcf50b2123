"""No kernel is compiled while the robot moves: a process prints those that a walk is the first to call.

usage: test_late_kernels.py warm_up | robot | servos SCENE
    warm_up   kernels that the walk or its start call after scripts/setup has compiled them
    robot     kernels that the walk calls after its start
    servos    the same with the supervisor and emulated servos
"""

import subprocess
import sys
from collections import deque

import pytest
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


@pytest.mark.parametrize(
    "arguments",
    [
        ("robot", "flat"),
        ("robot", "map"),
        ("servos", "flat"),
        ("warm_up", "flat"),
    ],
)
def test_every_kernel_of_a_walk_is_compiled_before_the_first_reading(arguments):
    """On rods, a table and emulated servos; and those of a default run by scripts/setup.

    In a process of its own: in this one, other tests may have called the kernels.
    """
    command = [sys.executable, __file__, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


if __name__ == "__main__":
    main(*sys.argv[1:])
