"""Stills of every gait, from the closed loop with the default controller."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.locomotion.cases import DT, Case
from slot_core.drawing.shapes import bent_legs
from slot_core.gait.gait import read_gaits
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_lab.report.robot_drawing import Snapshot, Viewpoint, draw_robot

COLUMNS = 5
SETTLED = 3.0  # s, before the first still
FIVE = math.radians(5.0)
POSTURES = {
    "lie": Case(SETTLED, gait="lie"),
    "sit": Case(SETTLED, gait="sit"),
    "stand": Case(SETTLED, gait="stand"),
    "stand, roll 5 deg": Case(SETTLED, gait="stand", pose=(0.04, FIVE, 0.0)),
    "stand, pitch 5 deg": Case(SETTLED, gait="stand", pose=(0.04, 0.0, FIVE)),
}
STRIDES = {
    "walk, 0.05 m/s": Case(SETTLED, velocity=(0.05, 0.0, 0.0)),
    "walk to the left, 0.05 m/s": Case(SETTLED, velocity=(0.0, 0.05, 0.0)),
    "walk, turn in place, 0.15 rad/s": Case(SETTLED, velocity=(0.0, 0.0, 0.15)),
    "fast_walk, 0.08 m/s": Case(SETTLED, gait="fast_walk", velocity=(0.08, 0.0, 0.0)),
    "crawl, 0.02 m/s": Case(SETTLED, gait="crawl", velocity=(0.02, 0.0, 0.0)),
    "paper_walk": Case(SETTLED, gait="paper_walk", velocity=(0.08, 0.0, 0.0)),
    "paper_crawl": Case(SETTLED, gait="paper_crawl", velocity=(0.02, 0.0, 0.0)),
}


def draw(path: Path) -> None:
    """Write a PNG: the postures in its first row, then a stride a row at equal shares of it."""
    figure = Figure(
        figsize=(1.9 * COLUMNS, 1.25 * (1 + len(STRIDES))), layout="constrained"
    )
    robot, camera = read_robot(), Viewpoint()
    rows = [[(name, poses(case, [0.0])[0]) for name, case in POSTURES.items()]]
    for name, case in STRIDES.items():
        period = read_gaits().strides[case.gait].period
        found = poses(case, np.arange(COLUMNS) / COLUMNS * period)
        rows.append([(name if k == 0 else "", pose) for k, pose in enumerate(found)])
    for i, row in enumerate(rows):
        for k, (title, pose) in enumerate(row):
            ax = figure.add_subplot(len(rows), COLUMNS, i * COLUMNS + k + 1)
            draw_robot(ax, pose, robot, camera)
            ax.set_title(title, fontsize=9, loc="left")
            for shape in ax.collections:
                shape.set_clip_on(False)  # a leg may stand above the ground's plot
            for text in ax.texts:  # arrows too, which have no words
                text.set_visible(not text.get_text())  # there is no room for the scale
    figure.savefig(path, dpi=130)


def poses(case: Case, times: Sequence[float]) -> list[Snapshot]:
    """The robot at `times` (s) after it has settled in the case, to the nearest tick."""
    loop = ClosedLoop(case.scene, case.gait, np.array(case.velocity), 1)
    if case.pose is not None:
        loop.controller.scheduler.set_pose(np.array(case.pose))
    sim, robot, found = loop.plant.robot, read_robot(), {}
    wanted = [round((case.duration + time) / DT) for time in times]
    for k, _ in enumerate(loop.run(max(wanted) + 1)):
        legs = bent_legs(sim.nodes, sim.directors, sim.quaternion, robot)
        found[k] = Snapshot(
            k * DT, sim.position, sim.quaternion, legs, sim.ground_force
        )
    return [found[k] for k in wanted]
