"""Drawings of the robot: solids in an orthographic view, painted from far to near."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_core.drawing.shapes import FORCE_SCALE, LEAST_FORCE, Legs, leg_bars, normals
from slot_core.robot import LEGS, RobotParameters

SUN = np.array([0.25, -0.45, 0.86]) / np.linalg.norm([0.25, -0.45, 0.86])
AMBIENT = 0.55  # brightness of a face turned away from the sun
GROUND_HALF = (0.26, 0.22)  # m, of the ground drawn around the robot, along x and y
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


@dataclass(frozen=True)
class Snapshot:
    """Torso pose, leg shapes and ground forces at one time, in odom."""

    t: float  # s since the start
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


@dataclass(frozen=True)
class Solid:
    """Flat faces of one colour, corners counter-clockwise seen from outside."""

    faces: Array  # (m, 4, 3) m
    colour: str


def draw_robot(
    ax: Axes, pose: Snapshot, robot: RobotParameters, camera: Viewpoint
) -> None:
    """Draw ground, shadow, legs, torso and ground forces into `ax`, whose unit is the metre.

    The plot's origin is the point of the ground below the torso. Lines on the ground are fixed
    in odom and labelled with their x.
    """
    centre = np.array([pose.position[0], pose.position[1], 0.0])
    solids = [torso_solid(pose, robot), *leg_solids(pose, robot)]
    _draw_ground(ax, centre, camera)
    _draw_shadow(ax, solids, centre, camera)
    _draw_solids(ax, solids, centre, camera)
    _draw_forces(ax, pose, centre, camera)
    ax.set_aspect("equal")
    ax.set_axis_off()


def torso_solid(pose: Snapshot, robot: RobotParameters) -> Solid:
    """The torso's box."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = Rotation.from_quat(pose.quaternion).apply(
        signs * np.array(robot.torso.size) / 2
    )
    return Solid((pose.position + corners)[np.array(BOX_FACES)], palette.TORSO)


def leg_solids(pose: Snapshot, robot: RobotParameters) -> list[Solid]:
    """The legs, with their width and their taper."""
    bars = leg_bars(pose.legs, robot)
    return [
        Solid(faces, palette.LEG_COLOURS[leg]) for leg, faces in zip(LEGS, bars.faces)
    ]


def _draw_solids(
    ax: Axes, solids: list[Solid], centre: Array, camera: Viewpoint
) -> None:
    faces = np.concatenate([solid.faces for solid in solids])
    colours = np.concatenate([[to_rgb(s.colour)] * len(s.faces) for s in solids])
    normal = normals(faces)
    seen = normal @ camera.toward > 0
    light = AMBIENT + (1 - AMBIENT) * (normal @ SUN).clip(min=0.0)
    depth = np.where(seen, faces.mean(axis=1) @ camera.toward, np.inf)
    order = np.argsort(depth)[: int(seen.sum())]
    shaded = (colours * light[:, None])[order]
    polygons = camera.project(faces[order] - centre)
    ax.add_collection(
        PolyCollection(list(polygons), color=shaded, linewidths=0.4, zorder=3)
    )


def _draw_shadow(
    ax: Axes, solids: list[Solid], centre: Array, camera: Viewpoint
) -> None:
    faces = np.concatenate([solid.faces for solid in solids]) * [1.0, 1.0, 0.0]
    polygons = camera.project(faces - centre)
    ax.add_collection(PolyCollection(list(polygons), color="#d3d9df", zorder=2))


def _draw_ground(ax: Axes, centre: Array, camera: Viewpoint) -> None:
    half = np.array([*GROUND_HALF, 0.0])
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half
    outline = camera.project(corners)
    ax.add_collection(PolyCollection([outline], facecolors=palette.SHADE, zorder=0))
    ends = np.array([centre[0] - half[0], centre[0] + half[0]]) / GROUND_LINE
    marks = GROUND_LINE * np.arange(math.ceil(ends[0]), math.floor(ends[1]) + 1)
    lines = [
        np.array([[x, -half[1], 0.0], [x, half[1], 0.0]]) for x in marks - centre[0]
    ]
    shown = [camera.project(line) for line in lines]
    ax.add_collection(LineCollection(shown, colors="white", zorder=1))
    for x, line in zip(marks, shown):
        ax.annotate(f"{x:.1f} m", line[0].tolist(), (0, -3), **MARK)
    (left, low), (right, high) = outline.min(axis=0), outline.max(axis=0)
    ax.set_xlim(left, right)
    ax.set_ylim(low - 0.03, high + 0.02)


def _draw_forces(ax: Axes, pose: Snapshot, centre: Array, camera: Viewpoint) -> None:
    arrow = {
        "arrowstyle": "-|>",
        "color": palette.INK,
        "lw": 1.6,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    for foot, force in zip(pose.legs.nodes[:, -1] * [1.0, 1.0, 0.0], pose.force):
        if np.linalg.norm(force) > LEAST_FORCE:
            ends = np.array([foot, foot + FORCE_SCALE * force]) - centre
            tail, head = camera.project(ends).tolist()
            ax.annotate("", head, tail, zorder=4, arrowprops=arrow)
