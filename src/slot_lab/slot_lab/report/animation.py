"""Animation of a walk: the robot from the side over two strides, with its bent legs and forces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from slot_core.arrays import Array
from slot_core.progress import Tell, untold
from slot_core.refusal import InputError
from slot_core.robot import RobotParameters, read_robot
from slot_lab.bags.bag import Bag
from slot_lab.bags.recorded_walk import seconds, stride_period
from slot_lab.bags.topics import LEG_STATES
from slot_lab.report.plots import read_poses
from slot_lab.report.robot_drawing import Snapshot, Viewpoint, draw_robot

STRIDES = 2  # the last ones
SHOWN_WITHOUT_STRIDE = 1.5  # s, shown of a run without a stride
SLOWER = 2.0  # times slower than the run
SIZE, DPI = (6.4, 2.6), 100  # inches, dots per inch
SIDE = Viewpoint(azimuth=np.radians(-90.0), elevation=np.radians(11.0))
BELOW, ABOVE = (
    0.07,
    0.14,
)  # m shown below and above the point of the ground below the torso
SUFFIXES = (".gif", ".png", ".webp")


class AnimationError(InputError):
    """An animation cannot be made; the message is one line."""


def animate(bag: Bag, path: Path, tell: Tell = untold) -> None:
    """Write the last STRIDES of a walk as a GIF, PNG or WebP that moves, in a loop.

    Raises AnimationError for another suffix, BagError if the bag holds no leg shapes, OSError.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise AnimationError(
            f"{path}: expected a name that ends in {', '.join(SUFFIXES)}"
        )
    times, robot = frame_times(bag), read_robot()
    pause = round(1e3 * SLOWER * float(np.diff(times).mean()))  # ms
    with path.open("wb") as file:
        frames: list[Image.Image] = []
        for pose in read_poses(bag, times, robot):
            tell(len(frames) / len(times))
            frames.append(draw_frame(pose, robot))
        frames[0].save(
            file,
            path.suffix[1:],
            save_all=True,
            append_images=frames[1:],
            duration=pause,
            loop=0,
        )


def frame_times(bag: Bag) -> Array:
    """Graph times (n,) s of the leg shapes in the last STRIDES, without the one that is the first.

    Without a stride, or in a shorter run, in the last STILL. Raises AnimationError for less than
    two.
    """
    t = seconds(bag.series(LEG_STATES).stamp)
    if len(t) < 2:
        raise AnimationError(
            f"{bag.path}: {LEG_STATES} holds {len(t)} messages, less than 2"
        )
    length = STRIDES * (stride_period(bag) or SHOWN_WITHOUT_STRIDE / STRIDES)
    return t[-max(2, round(length / float(np.median(np.diff(t))))) :]


def draw_frame(pose: Snapshot, robot: RobotParameters) -> Image.Image:
    """The robot from the side."""
    figure = Figure(figsize=SIZE, dpi=DPI)
    canvas = FigureCanvasAgg(figure)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    draw_robot(ax, pose, robot, SIDE)
    ax.set_ylim(-BELOW, ABOVE)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
