"""Learns to walk straight on floors of any friction; writes walk.onnx and learning.png.

Needs `scripts/setup --learn`. The graph walks with it by `scripts/run --policy onnx:walk.onnx`.
"""

import argparse
import os

from slot_lab.learning.evolution import Evolution, learn, shape_of, trials
from slot_lab.learning.learned_walk import compare, draw, export
from slot_lab.learning.task import make_task

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--generations", type=int, default=60)
parser.add_argument(
    "--pairs", type=int, default=16, help="half the networks of a generation"
)
parser.add_argument(
    "--scheduler", default="", metavar="ADDRESS", help="of dask.distributed"
)
options = parser.parse_args()

TASK = make_task(
    level="standard",
    duration=20.0,
    servos=False,
    drawn={
        "scene.floor.friction": (0.15, 0.7),
        "velocity": ((0.04, 0.0, 0.0), (0.055, 0.0, 0.0)),
    },
)
EVOLUTION = Evolution(
    options.generations,
    options.pairs,
    step=0.0028,
    threads=len(os.sched_getaffinity(0)),
)
history = []
with trials(options.scheduler) as evaluate:
    for found in learn(TASK, EVOLUTION, evaluate):
        history.append(found)
        print(
            f"{found.generation:4d} generations, {found.steps:8d} steps: {found.test:.4f} a step"
        )
export("walk.onnx", TASK, shape_of(TASK), history[-1].best)
draw(history, "learning.png")
print(compare("onnx:walk.onnx", "gait_alone"))
