"""Drawing of the robot for a viewer, kept up to date by the messages of the graph.

The messages may come from rclpy or, read by the `rosbags` library, from a bag. On the real robot
no topic has the shape of the legs: they are then drawn as without stress, and pale.

A shape is points and colours in odom, for any viewer: `visualizer_node` makes ROS markers of it,
`slot_bringup.playing.scene_view` shows it in the browser.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_core.messages import decode
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


NATURAL_NODES = 20  # of a leg whose shape is not known
PATH_STEP = 0.005  # m between two points of a path
PATH_POINTS = 2000  # the oldest points of a longer path are dropped
REFERENCE, DEMANDED = rgb(palette.SECONDARY), rgb(palette.INK)


class Trace:
    """Line through the places where something was, drawn by a name and in a colour."""

    def __init__(self, name: str, colour: Array) -> None:
        self._name, self._colour = name, colour
        self._points: list[Array] = []

    def extend(self, point: Array) -> dict[str, Shape]:
        """The line with one more point (3,) m; nothing if that is closer than PATH_STEP."""
        if (
            self._points
            and np.linalg.norm(point - self._points[-1]) < PATH_STEP
        ):
            return {}
        self._points = [*self._points[-PATH_POINTS + 1 :], point]
        line = path_strip(np.array(self._points), self._colour)
        return {self._name: line} if len(self._points) > 1 else {}


class Drawing:
    """Shapes by name, from the newest message of every topic."""

    def __init__(self, robot: RobotParameters, torque_max: float) -> None:
        """torque_max: torque of a servo (N m) at which its tendon is drawn as fully loaded."""
        self._robot = robot
        self._tension_max = torque_max / robot.tendon.spool_radius
        self._position, self._quaternion = (
            np.zeros(3),
            np.array([0.0, 0.0, 0.0, 1.0]),
        )
        self._legs = natural_legs(
            self._position, self._quaternion, robot, NATURAL_NODES
        )
        self._placed = False  # whether a pose has been received
        self._simulated = False  # whether the exact pose has been received
        self._path = Trace("path", LEG_COLOURS[0])
        self._reference_path = Trace("reference_path", REFERENCE)

    def receive(self, topic: str, message: Any) -> dict[str, Shape]:
        """Shapes that a message changes; none of a topic that is not drawn.

        Raises ValueError for a message whose arrays do not fit, and for values that are not finite.
        """
        return self._DRAW[topic](self, message) if topic in self._DRAW else {}

    def _draw_truth(self, message: Any) -> dict[str, Shape]:
        self._simulated = True
        _, position, quaternion, *_ = decode.odometry(message)
        return self._draw_torso(position, quaternion)

    def _draw_estimate(self, message: Any) -> dict[str, Shape]:
        if self._simulated:
            return {}
        state = decode.estimate(message).state
        quaternion = Rotation.from_euler("xyz", _finite(state)[:3]).as_quat()
        shapes = self._draw_torso(state[3:6], quaternion)
        self._legs = natural_legs(
            self._position, quaternion, self._robot, NATURAL_NODES
        )
        return shapes | {"legs": leg_bars(self._legs, self._robot, known=False)}

    def _draw_torso(
        self, position: Array, quaternion: Array
    ) -> dict[str, Shape]:
        self._position, self._quaternion = (
            _finite(position),
            _finite(quaternion),
        )
        self._placed = True
        return {
            "torso": torso_box(position, quaternion, self._robot),
            **self._path.extend(position),
        }

    def _draw_legs(self, message: Any) -> dict[str, Shape]:
        self._simulated = True
        _, tension, force, nodes, directors = decode.legs(message)
        self._legs = bent_legs(nodes, directors, self._quaternion, self._robot)
        return {
            "legs": leg_bars(self._legs, self._robot),
            "tendons": self._tendons(tension),
            "ground_forces": force_arrows(nodes[:, -1], force, LEG_COLOURS),
        }

    def _draw_load(self, message: Any) -> dict[str, Shape]:
        """Tendons with the tension T = torque / radius of the spool, where it is not simulated."""
        if self._simulated or not self._placed:
            return {}
        _, _, torque = decode.joint_loads(message)
        return {
            "tendons": self._tendons(
                _finite(torque) / self._robot.tendon.spool_radius
            )
        }

    def _tendons(self, tension: Array) -> Shape:
        return tendon_strips(
            self._legs, tension, self._robot, self._tension_max
        )

    def _draw_reference(self, message: Any) -> dict[str, Shape]:
        """Reference pose of the torso now, its way over the horizon, and where it was."""
        reference = _finite(decode.preview(message).reference)
        position, size = reference[0, 3:6], np.array(self._robot.torso.size)
        quaternion = Rotation.from_euler("xyz", reference[0, :3]).as_quat()
        return {
            "reference": box_edges(position, quaternion, size, REFERENCE),
            "horizon": path_strip(reference[:, 3:6], REFERENCE),
            **self._reference_path.extend(position),
        }

    def _draw_plan(self, message: Any) -> dict[str, Shape]:
        """Planned forces of the first stage at the tips of the legs, and the predicted motion."""
        if not self._placed:
            return {}
        _, plan = decode.plan(message)
        colours, tips = (
            np.tile(DEMANDED, (len(LEGS), 1)),
            self._legs.nodes[:, -1],
        )
        shapes: dict[str, Shape] = {
            "demanded_forces": force_arrows(
                tips, _finite(plan.force[0]), colours
            )
        }
        if len(plan.pose) and len(plan.foot):
            shapes["predicted_path"] = path_strip(
                _finite(plan.pose)[:, 3:], DEMANDED
            )
            shapes["predicted_feet"] = Strips(
                _finite(plan.foot).swapaxes(0, 1), LEG_COLOURS, PATH_WIDTH
            )
        return shapes

    _DRAW: ClassVar[dict[str, Callable[[Drawing, Any], dict[str, Shape]]]] = {
        "/ground_truth/odom": _draw_truth,
        "/ground_truth/legs": _draw_legs,
        "/mpc_state": _draw_estimate,
        "/joint_states": _draw_load,
        "/gait_preview": _draw_reference,
        "/tendon_plan": _draw_plan,
    }
    TOPICS = tuple(_DRAW)


def _finite(values: Array) -> Array:
    if not np.isfinite(values).all():
        raise ValueError(f"{values.tolist()}: expected finite numbers")
    return values
