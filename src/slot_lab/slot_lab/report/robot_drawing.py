"""Drawings of the robot at recorded times, and a walk that moves.

Solids in an orthographic view, painted from far to near.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.command_line import Tell, untold
from slot_core.drawing import palette
from slot_core.drawing.drawing import (
    CORNERS,
    FORCE_SCALE,
    LEAST_FORCE,
    NATURAL_NODES,
    Legs,
    bent_legs,
    leg_bars,
    natural_legs,
    normals,
    rgb,
)
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.messages import decode
from slot_core.refusal import InputError
from slot_core.robot import LEGS, RobotParameters, read_robot
from slot_lab.bags.bag import Bag
from slot_lab.bags.recorded_walk import read_motion, seconds, stride_period
from slot_lab.bags.topics import LEG_STATES

SUN = np.array([0.25, -0.45, 0.86]) / np.linalg.norm([0.25, -0.45, 0.86])
SHADOW = "#d3d9df"
AMBIENT = 0.55  # brightness of a face turned away from the sun
# m, of the ground drawn around the robot, along x and y
GROUND_HALF = (0.26, 0.22)
GROUND_LINE = 0.1  # m between lines on the ground
MARK: dict[str, Any] = {
    "textcoords": "offset points",
    "ha": "center",
    "va": "top",
    "fontsize": 8,
    "color": palette.INK,
}
BOX_FACES = (
    (0, 1, 3, 2),
    (4, 6, 7, 5),
    (0, 4, 5, 1),
    (2, 3, 7, 6),
    (0, 2, 6, 4),
    (1, 5, 7, 3),
)
STRIDES = 2  # the last ones, of an animation
SHOWN_WITHOUT_STRIDE = 1.5  # s, shown of a run without a stride
SLOWER = 2.0  # times slower than the run
SIZE, DPI = (6.4, 2.6), 100  # inches, dots per inch
BELOW, ABOVE = 0.07, 0.14  # m shown below and above the ground below the torso
SUFFIXES = (".gif", ".png", ".webp")


@dataclass(frozen=True)
class Snapshot:
    """Torso pose, leg shapes and ground forces at one time, in odom."""

    position: Array  # (3,) m
    quaternion: Array  # (4,) x y z w
    legs: Legs
    force: Array  # (4, 3) N, of the ground on the legs


@dataclass(frozen=True)
class Viewpoint:
    """An orthographic view from a direction given by azimuth and elevation, rad."""

    azimuth: float = math.radians(-70.0)
    elevation: float = math.radians(22.0)

    @property
    def toward(self) -> Array:
        """(3,) unit vector from the scene to the camera."""
        c = math.cos(self.elevation)
        return np.array(
            [
                c * math.cos(self.azimuth),
                c * math.sin(self.azimuth),
                math.sin(self.elevation),
            ]
        )

    def project(self, points: Array) -> Array:
        """(..., 2) right and up in the plot of points (..., 3), m."""
        right = np.array([-math.sin(self.azimuth), math.cos(self.azimuth), 0.0])
        return np.stack(
            [points @ right, points @ np.cross(self.toward, right)], axis=-1
        )


SIDE = Viewpoint(azimuth=np.radians(-90.0), elevation=np.radians(11.0))


def snapshot(sim: SimulatedRobot) -> Snapshot:
    """A simulated robot as it is now."""
    legs = bent_legs(sim.nodes, sim.directors, sim.quaternion, sim.parameters)
    return Snapshot(sim.position, sim.quaternion, legs, sim.ground_force)


def draw_robot(
    ax: Axes, pose: Snapshot, robot: RobotParameters, camera: Viewpoint
) -> None:
    """Draw ground, shadow, legs, torso and ground forces into `ax`, whose unit is the metre.

    The plot's origin is the point of the ground below the torso. Lines on the ground are fixed
    in odom and labelled with their x.
    """
    centre = np.array([pose.position[0], pose.position[1], 0.0])
    faces, colours = solid_faces(pose, robot)
    _draw_ground(ax, centre, camera)
    shadow = faces * [1.0, 1.0, 0.0]
    ax.add_collection(
        PolyCollection(
            list(camera.project(shadow - centre)), color=SHADOW, zorder=2
        )
    )
    _draw_solids(ax, faces, colours, centre, camera)
    _draw_forces(ax, pose, centre, camera)
    ax.set_aspect("equal")
    ax.set_axis_off()


def solid_faces(pose: Snapshot, robot: RobotParameters) -> tuple[Array, Array]:
    """Faces (k, 4, 3) m of torso and legs, counter-clockwise outside; colours (k, 3)."""
    corners = Rotation.from_quat(pose.quaternion).apply(
        CORNERS * robot.torso.size
    )
    legs = leg_bars(pose.legs, robot)
    torso = (pose.position + corners)[np.array(BOX_FACES)]
    faces = np.concatenate([torso, *legs.faces])
    colours = np.concatenate(
        [
            np.tile(rgb(palette.TORSO), (len(torso), 1)),
            np.repeat(legs.colours, legs.faces.shape[1], axis=0),
        ]
    )
    return faces, colours


def _draw_solids(
    ax: Axes, faces: Array, colours: Array, centre: Array, camera: Viewpoint
) -> None:
    normal = normals(faces)
    seen = normal @ camera.toward > 0
    light = AMBIENT + (1 - AMBIENT) * (normal @ SUN).clip(min=0.0)
    depth = np.where(seen, faces.mean(axis=1) @ camera.toward, np.inf)
    order = np.argsort(depth)[: int(seen.sum())]
    ax.add_collection(
        PolyCollection(
            list(camera.project(faces[order] - centre)),
            color=(colours * light[:, None])[order],
            linewidths=0.4,
            zorder=3,
        )
    )


def _draw_ground(ax: Axes, centre: Array, camera: Viewpoint) -> None:
    half = np.array([*GROUND_HALF, 0.0])
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half
    outline = camera.project(corners)
    ax.add_collection(
        PolyCollection([outline], facecolors=palette.SHADE, zorder=0)
    )
    ends = np.array([centre[0] - half[0], centre[0] + half[0]]) / GROUND_LINE
    marks = GROUND_LINE * np.arange(math.ceil(ends[0]), math.floor(ends[1]) + 1)
    shown = [
        camera.project(np.array([[x, -half[1], 0.0], [x, half[1], 0.0]]))
        for x in marks - centre[0]
    ]
    ax.add_collection(LineCollection(shown, colors="white", zorder=1))
    for x, line in zip(marks, shown):
        ax.annotate(f"{x:.1f} m", line[0].tolist(), (0, -3), **MARK)
    (left, low), (right, high) = outline.min(axis=0), outline.max(axis=0)
    ax.set(xlim=(left, right), ylim=(low - 0.03, high + 0.02))


def _draw_forces(
    ax: Axes, pose: Snapshot, centre: Array, camera: Viewpoint
) -> None:
    arrow = {
        "arrowstyle": "-|>",
        "color": palette.INK,
        "lw": 1.6,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    for foot, force in zip(
        pose.legs.nodes[:, -1] * [1.0, 1.0, 0.0], pose.force
    ):
        if np.linalg.norm(force) > LEAST_FORCE:
            tail, head = camera.project(
                np.array([foot, foot + FORCE_SCALE * force]) - centre
            ).tolist()
            ax.annotate("", head, tail, zorder=4, arrowprops=arrow)


def animate(bag: Bag, path: Path, tell: Tell = untold) -> None:
    """Write the last STRIDES of a walk as a GIF, PNG or WebP that moves, in a loop.

    Raises InputError for another suffix, BagError if the bag holds no leg shapes, OSError.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
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
    """Graph times (n,) s of the leg shapes in the last STRIDES; a loop repeats no frame.

    Without a stride, of the last SHOWN_WITHOUT_STRIDE. Raises InputError for less than
    two.
    """
    t = seconds(bag.series(LEG_STATES).stamp)
    if len(t) < 2:
        raise InputError(
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


def read_poses(
    bag: Bag, times: Array, robot: RobotParameters
) -> list[Snapshot]:
    """The robot at the recorded states nearest to `times` (s of graph time).

    Without recorded leg states it has stress-free legs and no forces.
    """
    motion, found = read_motion(bag), bag.counts.get(LEG_STATES)
    states = [m for _, m in bag.messages(LEG_STATES)] if found else []
    t = seconds(np.array([decode.stamp(message) for message in states]))
    poses = []
    for time in times:
        if states:
            state = states[k := int(np.abs(t - time).argmin())]
            time = t[k]  # noqa: PLW2901 - of the state
        m = int(np.abs(motion.t - time).argmin())
        place = motion.position[m], motion.quaternion[m]
        if states:
            _, _, force, nodes, directors = decode.legs(state)
            legs = bent_legs(nodes, directors, motion.quaternion[m], robot)
        else:
            force = np.zeros((len(LEGS), 3))
            legs = natural_legs(*place, robot, NATURAL_NODES)
        poses.append(Snapshot(*place, legs, force))
    return poses
