"""Plots of a walk: the dashboard, and a filmstrip of the robot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase

from slot_core.arrays import Array
from slot_core.drawing.shapes import FORCE_SCALE, bent_legs
from slot_core.messages import decode
from slot_core.robot import LEGS, RobotParameters, read_robot
from slot_lab.bags.bag import Bag, BagError
from slot_lab.bags.recorded_walk import read_motion, read_ticks, seconds, stride_period
from slot_lab.bags.topics import LEG_STATES
from slot_lab.plot_file import write_plot
from slot_lab.report import panels
from slot_lab.report.metrics import WalkMetrics
from slot_lab.report.robot_drawing import Snapshot, Viewpoint, draw_robot

DPI = 100
SIZE, SHARP = (11.5, 9.2), 140  # inches, dots per inch: legible at the width of a page
WIDTHS = (1.0, 1.0, 1.2)  # of its columns, relative


def dashboard(bag: Bag, metrics: WalkMetrics, path: Path) -> None:
    """Write the dashboard of a walk as a PNG of 1610 x 1288 pixels; raises BagError."""
    write_plot(dashboard_figure(bag, metrics), path, SHARP)


def dashboard_figure(bag: Bag, metrics: WalkMetrics) -> Figure:
    """The dashboard; the label of each axes is the name of its panel."""
    figure = Figure(figsize=SIZE, dpi=SHARP, layout="constrained")
    figure.suptitle(bag.path.name, fontsize=14, fontweight="bold")
    left, middle, right = cast(
        Any, figure.subfigures(1, 3, wspace=0.03, width_ratios=WIDTHS)
    )
    motion = read_motion(bag)
    names = ["path", "state", "height", "speed", "tilt"]
    path, state, height, speed, tilt = _stack(left, names, (1.3, 0.12, 1.0, 1.0, 1.0))
    panels.draw_path(path, motion, motion.after(motion.t[0] + metrics.warm_up))
    panels.draw_states(state, bag, motion.t[0], motion.t[-1])
    panels.draw_height(height, motion, metrics.warm_up)
    panels.draw_speed(speed, motion, stride_period(bag), metrics.warm_up)
    panels.draw_tilt(tilt, motion, metrics.warm_up)

    names = [f"{kind} {leg}" for kind in ("angle", "force") for leg in LEGS]
    axes = _stack(middle, names, (1.0,) * len(names))
    panels.draw_angles(axes[:4], bag, motion.t[0], motion.t[-1])
    panels.draw_forces(axes[4:], bag, motion.t[0], motion.t[-1])

    latency, slack, disturbance = _stack(
        right, ["latency", "slack", "disturbance"], (1.0, 1.6, 1.0)
    )
    panels.draw_latency(latency, read_ticks(bag).after(motion.t[0] + metrics.warm_up))
    panels.draw_constraints(slack, bag, motion.t[0])
    panels.draw_disturbance(disturbance, bag, motion.t[0])
    return figure


def filmstrip(bag: Bag, path: Path, stills: int = 5) -> None:
    """Write a PNG with stills of the robot over its last stride.

    Raises BagError if the bag holds no leg shapes (only the simulator publishes them).
    """
    write_plot(filmstrip_figure(bag, stills), path, DPI)


def filmstrip_figure(bag: Bag, stills: int) -> Figure:
    """The filmstrip; its axes are the stills in the order of time."""
    robot, camera = read_robot(), Viewpoint()
    poses = read_poses(bag, still_times(bag, stills), robot)
    figure = Figure(figsize=(3.6 * stills, 2.2), dpi=DPI, layout="constrained")
    for i, pose in enumerate(poses):
        ax = figure.add_subplot(1, stills, i + 1, label=f"still {i}")
        draw_robot(ax, pose, robot, camera)
        ax.set_title(f"{pose.t:.2f} s", fontsize=11)
    figure.supxlabel(
        f"arrows: force of the ground, {1e-2 / FORCE_SCALE:.2f} N per cm", fontsize=9
    )
    return figure


def still_times(bag: Bag, stills: int) -> Array:
    """(stills,) s of graph time, evenly over the last stride; without a stride, over the run.

    Raises BagError if the bag holds no leg shapes.
    """
    t = seconds(bag.series(LEG_STATES).stamp)
    if not len(t):
        raise BagError(f"{bag.path}: {LEG_STATES} holds no messages")
    period = stride_period(bag) or np.inf
    return np.linspace(max(t[0], t[-1] - period), t[-1], stills)


def read_poses(bag: Bag, times: Array, robot: RobotParameters) -> list[Snapshot]:
    """The robot at the recorded leg states nearest to `times` (s of graph time)."""
    states = [message for _, message in bag.messages(LEG_STATES)]
    motion = read_motion(bag)
    t = seconds(np.array([decode.stamp(message) for message in states]))
    poses = []
    for time in times:
        k = int(np.abs(t - time).argmin())
        m = int(np.abs(motion.t - t[k]).argmin())
        _, _, force, nodes, directors = decode.legs(states[k])
        place = motion.position[m], motion.quaternion[m]
        legs = bent_legs(nodes, directors, motion.quaternion[m], robot)
        poses.append(Snapshot(float(t[k] - motion.t[0]), *place, legs, force))
    return poses


def _stack(
    figure: FigureBase, names: Sequence[str], heights: Sequence[float]
) -> list[Axes]:
    grid = figure.add_gridspec(len(names), 1, height_ratios=heights)
    return [figure.add_subplot(grid[i], label=name) for i, name in enumerate(names)]
