"""The walking robot with its markers as surfaces before a synthetic camera, for tests and rows of vision."""

import numpy as np

from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.geometry import Transform, matrix_of_quaternion, optical
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
from slot_core.vision.settings import VisionSettings
from slot_core.vision.synthetic_camera import Surface
from slot_lab.report.robot_drawing import Snapshot, solid_faces

BOARD = "film"
SKIN = np.full(
    (99, 99), 60, np.uint8
)  # of a face of its body; the edge of a print is lost


class Stage:
    """The robot with its plates and the board behind it, before the camera that films them."""

    def __init__(
        self, settings: VisionSettings, robot: RobotParameters
    ) -> None:
        self._points, self._robot = settings.points, robot
        camera = settings.film_camera
        self._to_camera = optical(
            Transform.of(camera.position, camera.rpy)
        ).inverse
        number = settings.dictionary_number
        if BOARD not in settings.boards:
            raise ConfigError(f"vision.yaml: boards: none named {BOARD}")
        self._board = make_board(settings.boards[BOARD])
        self._board_print = print_of(self._board, number)
        markers = {
            name: single_marker(i, settings.points.size)
            for i, name in settings.points.names.items()
        }
        self._prints = {
            name: print_of(marker, number) for name, marker in markers.items()
        }
        self._outline = next(iter(markers.values())).outline

    def plates(self, at: Snapshot) -> dict[str, Transform]:
        """Frames of the plates in odom by name: x along the leg outward, z away from its right side."""
        on_torso, base = (
            self._points.torso,
            Transform(matrix_of_quaternion(at.quaternion), at.position),
        )
        found = {TORSO: base @ Transform.of(on_torso.position, on_torso.rpy)}
        away = self._robot.leg.width / 2 + self._points.stand_off
        for leg, line, side in zip(LEGS, at.legs.nodes, at.legs.axes[0]):
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
                found[f"{leg}_{name}"] = Transform(
                    np.column_stack([x, np.cross(z, x), z]), point + away * z
                )
        return found

    def surfaces(
        self, at: Snapshot, soon: tuple[Snapshot, float] | None = None
    ) -> list[Surface]:
        """Surfaces before the camera; soon: the robot later, and the time (s) until then."""
        board = self._seen(
            self._board_print, self._board.pose.apply(self._board.outline)
        )
        faces, _ = solid_faces(at, self._robot)
        # clockwise as seen from outside
        body = [self._seen(SKIN, face[::-1]) for face in faces]
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


def _distance(surface: Surface) -> float:
    """Negative distance of the middle, m: the farthest comes first."""
    return -float(np.linalg.norm(surface.corners.mean(axis=0)))
