"""Plot of two walks over each other, with their differences."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Canvas

from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_core.geometry import rotate
from slot_lab.bags.bag import Bag
from slot_lab.bags.recorded_walk import TorsoTrack, read_motion
from slot_lab.plot_file import write_plot

DPI = 100
GRID: dict[str, Any] = {"color": palette.PALE, "lw": 0.5}


def draw(first: Bag, second: Bag, path: Path) -> None:
    """Write the plot; raises BagError, OSError."""
    write_plot(plot(first, second), path, DPI)


def plot(first: Bag, second: Bag) -> Canvas:
    """A row for each curve: both walks, and second minus first while both last."""
    walks = [read_motion(bag) for bag in (first, second)]
    times = [walk.t - walk.t[0] for walk in walks]
    a, b = (curves(walk) for walk in walks)
    figure = Canvas(figsize=(12.0, 1.9 * len(a)), dpi=DPI, layout="constrained")
    axes = figure.subplots(len(a), 2, sharex=True)
    shared = times[0][times[0] <= times[1][-1]]
    for (both, difference), (title, then), now in zip(axes, a.items(), b.values()):
        both.plot(times[0], then, color=palette.TRUE, lw=1.4, label=first.path.name)
        both.plot(
            times[1], now, color=palette.SECONDARY, lw=1.0, label=second.path.name
        )
        change = np.interp(shared, times[1], now) - then[: len(shared)]
        difference.plot(shared, change, color=palette.INK, lw=1.0)
        both.set_ylabel(title)
        for ax in (both, difference):
            ax.grid(**GRID)
    axes[0, 0].set_title("both runs")
    axes[0, 1].set_title("second - first")
    axes[0, 0].legend(frameon=False)
    for ax in axes[-1]:
        ax.set_xlabel("time since the start of each bag (s)")
    return figure


def curves(walk: TorsoTrack) -> Mapping[str, Array]:
    """Curves of the torso (n,) by title, in the frame of its place and heading at the start."""
    heading = walk.rpy[0, 2]
    forward, left = rotate(walk.position[:, :2] - walk.position[0, :2], -heading).T
    return {
        "forward (m)": forward,
        "left (mm)": 1e3 * left,
        "height (mm)": 1e3 * walk.position[:, 2],
        "speed (m/s)": walk.heading_velocity[:, 0],
        "roll (deg)": np.degrees(walk.rpy[:, 0]),
        "pitch (deg)": np.degrees(walk.rpy[:, 1]),
        "yaw (deg)": np.degrees(walk.rpy[:, 2] - heading),
    }
