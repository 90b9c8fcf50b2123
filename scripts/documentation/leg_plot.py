"""Draws the leg of the page Concepts, out of its plane: nodes, a frame, tendon and width."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d import proj3d

from slot_core import config
from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import RobotParameters, read_robot
from slot_core.simulation.rod_robot import RodRobot

# nodes of a leg, the leg, the segment whose frame is drawn
NODES, LEG, SHOWN = 13, 3, 6
PUSH = 30.0  # N, on the torso across the leg: the foot sticks, the leg bends and twists
PULLED_DEG = 95.0
SURFACE, TENDON = palette.LEG_COLOURS["FL"], palette.SECONDARY


def write(path: Path) -> None:
    """Write the plot of a leg of a robot that is pushed as a PNG."""
    robot = read_robot()
    changes = {"solver.nodes": NODES, "floor.friction": [3.0] * 4}
    sim = RodRobot(
        robot, config.replace(read_scene("flat"), changes), read_servo()
    )
    sim.push(PUSH * np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0), np.zeros(3))
    sim.advance(600, np.full(4, np.radians(PULLED_DEG)))
    figure = plt.figure(figsize=(8, 4.6), dpi=120)
    axes: Any = figure.add_subplot(projection="3d")
    draw(axes, robot, sim.state.node[LEG], sim.state.director[LEG])
    figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
    figure.savefig(path)


def draw(
    axes: Any, robot: RobotParameters, node: Array, director: Array
) -> None:
    """Draw a leg at nodes (N, 3) with directors (N-1, 3), mm in the plot."""
    node = 1e3 * node
    along = np.diff(node, axis=0)
    t = along / np.linalg.norm(along, axis=1, keepdims=True)
    width = np.vstack(
        [director[:1], (director[1:] + director[:-1]) / 2, director[-1:]]
    )
    half = 500.0 * robot.leg.width
    left, right = node - half * width, node + half * width
    axes.plot_surface(
        *np.stack([left, right], axis=1).transpose(2, 0, 1),
        color=SURFACE,
        alpha=0.25,
        linewidth=0,
    )
    for edge in (left, right):
        axes.plot(*edge.T, color=SURFACE, lw=1)
    axes.plot(*node.T, "o-", color="black", ms=4, lw=1)
    axes.set_box_aspect(
        np.ptp(np.vstack([left, right, node]), axis=0) + 10.0, zoom=0.95
    )
    axes.view_init(elev=32, azim=-60)
    axes.set_axis_off()
    below = 1e3 * robot.tendon.offset * np.cross(t, director)
    last = round(robot.tendon.end_fraction * (NODES - 1))
    tendon = (node[:-1] + below)[: last + 1]
    axes.plot(*tendon.T, color=TENDON, lw=2)
    middle, size = (node[SHOWN] + node[SHOWN + 1]) / 2, 28.0
    b = np.cross(t[SHOWN], director[SHOWN])
    for vector, name in ((t[SHOWN], "t"), (director[SHOWN], "d"), (b, "b")):
        axes.quiver(
            *middle,
            *(size * vector),
            color="black",
            lw=1.5,
            arrow_length_ratio=0.2,
        )
        away = 1.9 if name == "d" else 1.25  # it is seen almost from its end
        axes.text(
            *(middle + away * size * vector), name, style="italic", size=12
        )
    notes = (
        (node[0], (-40, 20), "node 0, the clamp", "black"),
        (node[-1], (8, -4), f"node {NODES - 1}, the tip", "black"),
        (tendon[-1], (-130, -22), "anchor of the tendon", TENDON),
        (
            tendon[3],
            (-150, -20),
            f"tendon, {1e3 * robot.tendon.offset:g} mm below",
            TENDON,
        ),
        (
            left[4],
            (30, 14),
            f"width {1e3 * robot.leg.width:g} mm, both edges touch",
            SURFACE,
        ),
    )
    for place, offset, text, colour in notes:
        axes.annotate(
            text,
            proj3d.proj_transform(*place, axes.get_proj())[:2],
            offset,
            textcoords="offset points",
            color=colour,
            size=9,
            arrowprops={"arrowstyle": "-", "color": colour, "lw": 0.7},
        )
