"""Shapes that show the robot in a 3-D viewer: bent legs, tendons, forces, torso and paths.

A shape is points and colours in odom, for any viewer: `slot_nodes.visualization` makes ROS markers
of it, `slot_bringup.rerun_log` logs it to rerun.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.report import palette
from slot_core.robot import LEGS, Array, Robot

FORCE_SCALE = 0.012  # m of arrow per N
LEAST_FORCE = 0.2  # N, smaller forces are not drawn
TENDON_WIDTH, ARROW_WIDTH, EDGE_WIDTH, PATH_WIDTH = 0.002, 0.003, 0.001, 0.002  # m
CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))  # of a box of edge length one
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


Shape: TypeAlias = Strips | Arrows | Box


def rgb(colour: str) -> Array:
    """(3,) red, green, blue in [0, 1] of #RRGGBB."""
    return np.frombuffer(bytes.fromhex(colour.removeprefix("#")), np.uint8) / 255


LEG_COLOURS = np.array([rgb(palette.LEG_COLOURS[leg]) for leg in LEGS])
SLACK, LOADED = rgb(palette.PALE), rgb("#C00000")  # tendons without load and at the largest


def torso_box(position: Array, quaternion: Array, robot: Robot) -> Box:
    """The torso at position (3,) m and quaternion (4,) x y z w."""
    return Box(position, quaternion, np.array(robot.torso.size), rgb(palette.TORSO))


def box_edges(position: Array, quaternion: Array, size: Array, colour: Array) -> Strips:
    """The edges of a box of size (3,) m, in one line."""
    corners = position + Rotation.from_quat(quaternion).apply(CORNERS * size)
    return Strips(corners[EDGE_WALK][None], colour[None], EDGE_WIDTH)


def natural_nodes(position: Array, quaternion: Array, robot: Robot, nodes: int) -> Array:
    """(4, nodes, 3) m, stress-free legs of a torso: where the bent ones are not known."""
    x = np.linspace(0.0, robot.leg.reach, nodes)
    rise = robot.leg.shape(x) - robot.leg.shape(0.0)
    along = x[None, :, None] * robot.outward[:, None]
    body = robot.clamps[:, None] + along + rise[None, :, None] * np.array([0.0, 0.0, 1.0])
    turned = Rotation.from_quat(quaternion).apply(body.reshape(-1, 3))
    return np.asarray(position + turned).reshape(body.shape)


def leg_strips(nodes: Array, robot: Robot, *, known: bool = True) -> Strips:
    """Centre lines of the legs at nodes (4, n, 3) m; pale if their shape is not known."""
    width = (robot.leg.thickness_clamp + robot.leg.thickness_tip) / 2
    return Strips(nodes, LEG_COLOURS if known else np.tile(SLACK, (4, 1)), width)


def tendon_strips(
    nodes: Array, quaternion: Array, tension: Array, robot: Robot, top: float
) -> Strips:
    """Tendons along the legs at nodes (4, n, 3) m, below the centre lines up to the anchor.

    quaternion (4,) of the torso: a leg bends in the x-z plane of its frame, which is fixed to the
    torso. The colour goes with the tension (4,) N from pale at zero to red at `top` (N).
    """
    turn = Rotation.from_quat(quaternion)
    last = round(robot.tendon.end_fraction * (nodes.shape[1] - 1)) + 1
    if robot.tendon.routing == "straight":
        x, z = robot.tendon.pulley
        pulley = nodes[:, 0] + turn.apply(x * robot.outward + [0.0, 0.0, z])
        points = np.stack([pulley, nodes[:, last - 1]], axis=1)
    else:
        side = turn.apply(np.cross([0.0, 0.0, 1.0], robot.outward))
        below = np.cross(side[:, None], np.gradient(nodes, axis=1))
        below /= np.linalg.norm(below, axis=2, keepdims=True)
        points = (nodes + robot.tendon.offset * below)[:, :last]
    share = np.clip(tension / top, 0.0, 1.0)[:, None]
    return Strips(points, (1 - share) * SLACK + share * LOADED, TENDON_WIDTH)


def force_arrows(tips: Array, force: Array, colours: Array) -> Arrows:
    """Forces (n, 3) N on the tips (n, 3) m of the legs; those below LEAST_FORCE have no arrow."""
    drawn = np.linalg.norm(force, axis=1) > LEAST_FORCE
    return Arrows(tips[drawn], FORCE_SCALE * force[drawn], colours[drawn], ARROW_WIDTH)


def path_strip(points: Array, colour: Array) -> Strips:
    """One line through points (n, 3) m."""
    return Strips(points[None], colour[None], PATH_WIDTH)
