"""The walking robot with its markers as surfaces before a synthetic camera, for tests and rows of vision."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.geometry import Transform, optical
from slot_core.robot import (
    LEG_POINTS,
    LEGS,
    TORSO,
    RobotParameters,
    arc_length,
    at_shares,
)
from slot_core.vision.board import (
    GreyImage,
    make_board,
    print_of,
    single_marker,
)
from slot_core.vision.settings import TrackedMarkers, VisionSettings
from slot_core.vision.synthetic_camera import Surface

BOARD = "film"
SKIN = np.full((4, 4), 60, np.uint8)  # of the robot's body


class FilmedRobot(NamedTuple):
    """The robot in a film: torso and legs in odom."""

    base: Transform  # of base_link
    nodes: Array  # (4, N, 3) m, centre lines
    sides: Array  # (4, N, 3) unit vectors along the width, to the right looking outward


def filmed(
    robot: RobotParameters, base: Transform, nodes: Array, directors: Array
) -> FilmedRobot:
    """The robot with directors (4, N-1, 3) of its segments, or (4, 0, 3): legs without twist."""
    sides = np.concatenate([directors[:, :1], directors], axis=1)
    if not directors.size:
        right = robot.rightward @ base.rotation.T
        sides = np.broadcast_to(right[:, None], nodes.shape)
    return FilmedRobot(base, nodes, sides)


def plates(
    robot: RobotParameters, settings: TrackedMarkers, at: FilmedRobot
) -> dict[str, Transform]:
    """Frames of the plates in odom by name: x along the leg outward, z away from its right side."""
    found = {
        TORSO: at.base
        @ Transform.of(settings.torso.position, settings.torso.rpy)
    }
    for leg, line, side in zip(LEGS, at.nodes, at.sides):
        tangents = np.gradient(line, arc_length(line), axis=0)
        places = (
            at_shares(line),
            at_shares(line, tangents),
            at_shares(line, side),
        )
        for name, point, along, aside in zip(LEG_POINTS, *places):
            x = along / np.linalg.norm(along)
            z = aside - (aside @ x) * x
            z /= np.linalg.norm(z)
            middle = point + (robot.leg.width / 2 + settings.stand_off) * z
            found[f"{leg}_{name}"] = Transform(
                np.column_stack([x, np.cross(z, x), z]), middle
            )
    return found


class Stage:
    """The robot with its plates and the board behind it, before the camera that films them."""

    def __init__(
        self, settings: VisionSettings, robot: RobotParameters
    ) -> None:
        self._settings, self._robot = settings, robot
        camera = settings.film_camera
        self._to_camera = optical(
            Transform.of(camera.position, camera.rpy)
        ).inverse
        number = settings.dictionary_number
        if BOARD not in settings.boards:
            raise ConfigError(f"vision.yaml: boards: none named {BOARD}")
        self._board = make_board(settings.boards[BOARD])
        self._board_print = print_of(self._board, number)
        names = settings.points.names
        markers = {
            name: single_marker(i, settings.points.size)
            for i, name in names.items()
        }
        self._prints = {
            name: print_of(marker, number) for name, marker in markers.items()
        }
        self._outline = next(iter(markers.values())).outline

    def plates(self, at: FilmedRobot) -> dict[str, Transform]:
        """Frames of the plates in odom."""
        return plates(self._robot, self._settings.points, at)

    def surfaces(
        self, at: FilmedRobot, soon: tuple[FilmedRobot, float] | None = None
    ) -> list[Surface]:
        """Surfaces before the camera; soon: the robot later, and the time (s) until then."""
        board = self._seen(
            self._board_print, self._board.pose.apply(self._board.outline)
        )
        body = [self._seen(SKIN, face) for face in self._body(at)]
        later, shown = self.plates(soon[0]) if soon else {}, []
        for name, plate in self.plates(at).items():
            corners, velocity = plate.apply(self._outline), None
            if soon:
                velocity = (later[name].apply(self._outline) - corners) / soon[
                    1
                ]
            shown.append(self._seen(self._prints[name], corners, velocity))
        return [
            board,
            *sorted(body, key=_distance),
            *sorted(shown, key=_distance),
        ]

    def _seen(
        self, sheet: GreyImage, corners: Array, velocity: Array | None = None
    ) -> Surface:
        """A surface in the optical frame from corners (4, 3) and velocities in odom."""
        if velocity is not None:
            velocity = velocity @ self._to_camera.rotation.T
        return Surface(sheet, self._to_camera.apply(corners), velocity)

    def _body(self, at: FilmedRobot) -> Iterator[Array]:
        """Faces (4, 3) of torso and legs in odom, turned to the camera."""
        half = np.array(self._robot.torso.size) / 2
        around = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        for axis in range(3):
            for sign in (-1, 1):
                yield from _turned(
                    at.base.apply(np.insert(around, axis, sign, axis=1) * half),
                    self._to_camera,
                )
        leg = self._robot.leg
        for line, side in zip(at.nodes, at.sides):
            thick = (
                np.linspace(leg.thickness_clamp, leg.thickness_tip, len(line))
                / 2
            )
            normal = np.cross(side, np.gradient(line, axis=0))
            up = normal * (thick / np.linalg.norm(normal, axis=1))[:, None]
            for i in range(len(line) - 1):
                quad = [
                    line[i] - up[i],
                    line[i + 1] - up[i + 1],
                    line[i + 1] + up[i + 1],
                ]
                yield from _turned(
                    np.array([*quad, line[i] + up[i]]), self._to_camera
                )


def _distance(surface: Surface) -> float:
    """Negative distance of the middle, m: the farthest comes first."""
    return -float(np.linalg.norm(surface.corners.mean(axis=0)))


def _turned(corners: Array, to_camera: Transform) -> Iterator[Array]:
    """Corners (4, 3) in the order that faces the camera; none for a face seen from its edge."""
    for order in (corners, corners[::-1]):
        if Surface(SKIN, to_camera.apply(order)).faces_camera:
            yield order
