"""Shapes that show the robot in a 3-D viewer: bent legs, tendons, forces, torso and paths.

A shape is points and colours in odom, for any viewer: `visualizer_node` makes ROS
markers of it, `slot_bringup.playing.scene_view` shows it in the browser.
"""

import itertools
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_core.robot import LEGS, RobotParameters

FORCE_SCALE = 0.012  # m of arrow per N
LEAST_FORCE = 0.2  # N, smaller forces are not drawn
# m
TENDON_WIDTH, ARROW_WIDTH, EDGE_WIDTH, PATH_WIDTH = (0.002, 0.003, 0.001, 0.002)
# corners of a box of edge length one
CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
# a walk along all twelve edges, by row of CORNERS
EDGE_WALK = [0, 1, 3, 2, 0, 4, 5, 1, 5, 7, 3, 7, 6, 2, 6, 4]


@dataclass(frozen=True)
class Strips:
    """n polylines of m points each."""

    points: Array  # (n, m, 3) m
    colours: Array  # (n, 3) red, green, blue in [0, 1]
    width: float  # m


@dataclass(frozen=True)
class Arrows:
    """n arrows."""

    tail: Array  # (n, 3) m
    vector: Array  # (n, 3) m
    colours: Array  # (n, 3) red, green, blue in [0, 1]
    width: float  # m, of the shafts


@dataclass(frozen=True)
class Box:
    """A solid box."""

    centre: Array  # (3,) m
    quaternion: Array  # (4,) x y z w
    size: Array  # (3,) m, edge lengths
    colour: Array  # (3,) red, green, blue in [0, 1]


@dataclass(frozen=True)
class Bars:
    """n solid bars with m rectangular sections each."""

    corners: Array  # (n, m, 4, 3) m, of the sections, counter-clockwise seen from the bar's end
    colours: Array  # (n, 3) red, green, blue in [0, 1]

    @property
    def quads(self) -> NDArray[np.intp]:
        """(4 m - 2, 4) faces of a bar by row of its corners (4 m, 3), counter-clockwise outside."""
        row = np.arange(4 * self.corners.shape[1]).reshape(-1, 4)
        ahead = np.roll(row, -1, axis=1)
        sides = np.stack(
            [row[:-1], ahead[:-1], ahead[1:], row[1:]], axis=2
        ).reshape(-1, 4)
        return np.concatenate([sides, row[:1, ::-1], row[-1:]])

    @property
    def faces(self) -> Array:
        """(n, 4 m - 2, 4, 3) m, corners of the faces."""
        return self.corners.reshape(len(self.corners), -1, 3)[:, self.quads]


def halves(quads: NDArray[np.intp]) -> NDArray[np.intp]:
    """(2 k, 3) triangles of (k, 4) quadrilaterals, by rows of their corners."""
    return quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)


def normals(faces: Array) -> Array:
    """(k, 3) unit vectors out of faces (k, 4, 3) with corners counter-clockwise outside."""
    return _unit(np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1]))


Shape: TypeAlias = Strips | Arrows | Box | Bars


@dataclass(frozen=True)
class Legs:
    """Shape of the four legs, in odom."""

    nodes: Array  # (4, n, 3) m, centre lines, clamp first
    directors: Array  # (4, n - 1, 3) unit vectors along the width of the segments, to the right

    @property
    def axes(self) -> tuple[Array, Array]:
        """Unit vectors (4, n, 3) of the sections at the nodes: along width and thickness.

        The second is b = t x d of `dynamics/spatial/strain.py`, towards the tendon; at a node t and
        d are the means of the segments that it joins.
        """
        along = _at_nodes(_unit(np.diff(self.nodes, axis=1)))
        across = _at_nodes(self.directors)
        return across, _unit(np.cross(along, across))

    @property
    def fraction(self) -> Array:
        """(4, n) arc lengths of the nodes as shares of the legs' lengths."""
        arc = np.linalg.norm(np.diff(self.nodes, axis=1), axis=2).cumsum(axis=1)
        return np.pad(arc / arc[:, -1:], ((0, 0), (1, 0)))


def _at_nodes(values: Array) -> Array:
    """Unit vectors (4, n, 3) at the nodes from the segments' vectors (4, n - 1, 3)."""
    return _unit(
        np.concatenate(
            [values[:, :1], values[:, :-1] + values[:, 1:], values[:, -1:]],
            axis=1,
        )
    )


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def rgb(colour: str) -> Array:
    """(3,) red, green, blue in [0, 1] of #RRGGBB."""
    return (
        np.frombuffer(bytes.fromhex(colour.removeprefix("#")), np.uint8) / 255
    )


LEG_COLOURS = np.array([rgb(palette.LEG_COLOURS[leg]) for leg in LEGS])
# tendons without load and at the largest
SLACK, LOADED = (rgb(palette.PALE), rgb("#C00000"))


def torso_box(
    position: Array, quaternion: Array, robot: RobotParameters
) -> Box:
    """The torso at position (3,) m and quaternion (4,) x y z w."""
    return Box(
        position, quaternion, np.array(robot.torso.size), rgb(palette.TORSO)
    )


def box_edges(
    position: Array, quaternion: Array, size: Array, colour: Array
) -> Strips:
    """The edges of a box of size (3,) m, in one line."""
    corners = position + Rotation.from_quat(quaternion).apply(CORNERS * size)
    return Strips(corners[EDGE_WALK][None], colour[None], EDGE_WIDTH)


def bent_legs(
    nodes: Array, directors: Array, quaternion: Array, robot: RobotParameters
) -> Legs:
    """Legs at nodes (4, n, 3) m with directors (4, n - 1, 3).

    Without directors, (4, 0, 3), a leg lies in the plane of its azimuth, which is fixed to the
    torso at quaternion (4,) x y z w.
    """
    if not directors.size:
        directors = np.repeat(
            Rotation.from_quat(quaternion).apply(robot.rightward)[:, None],
            nodes.shape[1] - 1,
            axis=1,
        )
    return Legs(nodes, directors)


def natural_legs(
    position: Array, quaternion: Array, robot: RobotParameters, nodes: int
) -> Legs:
    """Stress-free legs of a torso, at `nodes` nodes: where the bent ones are not known."""
    x = np.linspace(0.0, robot.leg.reach, nodes)
    rise = robot.leg.shape(x) - robot.leg.shape(0.0)
    body = (
        robot.clamps[:, None]
        + x[None, :, None] * robot.outward[:, None]
        + rise[None, :, None] * np.array([0.0, 0.0, 1.0])
    )
    points = np.asarray(
        position + Rotation.from_quat(quaternion).apply(body.reshape(-1, 3))
    ).reshape(body.shape)
    return bent_legs(points, np.zeros((len(LEGS), 0, 3)), quaternion, robot)


def leg_bars(legs: Legs, robot: RobotParameters, *, known: bool = True) -> Bars:
    """The legs, with their width and their taper; pale if their shape is not known."""
    width, thickness = legs.axes
    d = robot.leg.width / 2 * width
    b = robot.leg.thickness(legs.fraction)[..., None] / 2 * thickness
    corners = legs.nodes[:, :, None] + np.stack(
        [-d - b, d - b, d + b, -d + b], axis=2
    )
    return Bars(
        corners, LEG_COLOURS if known else np.tile(SLACK, (len(LEGS), 1))
    )


def tendon_strips(
    legs: Legs, tension: Array, robot: RobotParameters, top: float
) -> Strips:
    """Tendons along the lower sides of the legs up to the anchors.

    The colour goes with the tension (4,) N from pale at zero to red at `top` (N).
    """
    last = round(robot.tendon.end_fraction * (legs.nodes.shape[1] - 1)) + 1
    points = (legs.nodes + robot.tendon.offset * legs.axes[1])[:, :last]
    share = np.clip(tension / top, 0.0, 1.0)[:, None]
    return Strips(points, (1 - share) * SLACK + share * LOADED, TENDON_WIDTH)


def force_arrows(tips: Array, force: Array, colours: Array) -> Arrows:
    """Forces (n, 3) N on the tips (n, 3) m of the legs; those below LEAST_FORCE have no arrow."""
    drawn = np.linalg.norm(force, axis=1) > LEAST_FORCE
    return Arrows(
        tips[drawn], FORCE_SCALE * force[drawn], colours[drawn], ARROW_WIDTH
    )


def path_strip(points: Array, colour: Array) -> Strips:
    """One line through points (n, 3) m."""
    return Strips(points[None], colour[None], PATH_WIDTH)
