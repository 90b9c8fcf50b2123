"""Process for test_warm_up.py: prints the kernels that a walk is the first to call.

usage: late_kernels.py warm_up | robot | servos SCENE
    warm_up   those that the walk or its start call after scripts/setup has compiled the kernels
    robot     those that the walk calls after its start
    servos    the same with emulated servos
"""

import sys
from collections import deque
from functools import partial

from numba.core.dispatcher import Dispatcher

from slot_core.dynamixel.settings import read_settings
from slot_core.emulator.emulated_bus import read_emulator
from slot_core.simulation import warm_up
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.simulation.driven_plant import DrivenPlant
from slot_core.simulation.plant import Plant

TICKS = 12  # a third of a stride; every stage of the controller answers in each tick


def loaded():
    """Every kernel of the project with the types of arguments for which it is compiled."""
    modules = [m for name, m in sys.modules.items() if name.startswith("slot_core.")]
    values = [v for module in modules for v in vars(module).values() if isinstance(v, Dispatcher)]
    return {(f"{v.__module__}.{v.__name__}", types) for v in values for types in v.signatures}


def main(what, scene):
    servos = partial(DrivenPlant, settings=read_settings(), emulator=read_emulator(), period=0.01)
    if what == "warm_up":
        warm_up.main()
        before = loaded()
    loop = ClosedLoop(scene, "walk", None, 0, make=servos if what == "servos" else Plant)
    if what != "warm_up":
        before = loaded()
    deque(loop.run(TICKS), maxlen=0)
    assert before
    for name, types in sorted(loaded() - before, key=str):
        print(f"{name}{types}"[:300])


if __name__ == "__main__":
    main(*sys.argv[1:])
