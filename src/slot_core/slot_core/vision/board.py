"""Boards of markers: corners in the board's frame, and their images.

Pose of a board in a camera from the rays of its corners, with its covariance.

A plane seen nearly from the front or from afar has two poses that explain it about as well,
mirrored at the line of sight (Collins, Bartoli, "Infinitesimal plane-based pose estimation", 2014:
IPPE).
Both are returned, each refined by Levenberg and Marquardt's method on the reprojection error

    e = sum |pi(R X + t) - x|^2,   pi(X, Y, Z) = (X / Z, Y / Z)

whose normal matrix gives the covariance s^2 (J^T J)^-1. An error of the camera's parameters moves
all rays x together, by S d, and so the pose by G d with G = (J^T J)^-1 J^T S: with the covariance C
of the calibration the pose has G C G^T, by the same error in every image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.geometry import Transform
from slot_core.vision.camera import Camera
from slot_core.vision.settings import BoardSettings

GreyImage = NDArray[np.uint8]
PRINT_CELL = 12  # px of a marker's cell in the image of a sheet
SQUARE = np.array(
    [[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]]
)
WHITE = 255
FINER = 8


@dataclass(frozen=True)
class Board:
    """Corners of a board's markers and its pose in the frame that it is fixed in.

    Corners run clockwise from the top left as the viewer sees them, which is OpenCV's order; x to
    the right, y up, z towards the viewer, origin in the middle.
    """

    corners: dict[int, Array]  # by id: (4, 3) m
    pose: Transform
    size: tuple[float, float]  # m, width and height with the white around

    @property
    def outline(self) -> Array:
        """(4, 3) m, corners of the white sheet."""
        return SQUARE * [*self.size, 0.0]


def make_board(settings: BoardSettings) -> Board:
    """The board of its settings."""
    pitch = settings.marker + settings.gap
    corners = {}
    for index, number in enumerate(settings.ids):
        row, column = divmod(index, settings.columns)
        x = (column - (settings.columns - 1) / 2) * pitch
        y = ((settings.rows - 1) / 2 - row) * pitch
        corners[number] = settings.marker * SQUARE + [x, y, 0.0]
    return Board(
        corners,
        Transform.of(settings.pose.position, settings.pose.rpy),
        (
            settings.columns * pitch + settings.gap,
            settings.rows * pitch + settings.gap,
        ),
    )


def single_marker(number: int, size: float) -> Board:
    """One marker with a third of its edge as white around it, in its own frame."""
    edge = size * (1 + 2 / 3)
    return Board(
        {number: size * SQUARE}, Transform(np.eye(3), np.zeros(3)), (edge, edge)
    )


def image_of(board: Board, dictionary: int, scale: float) -> GreyImage:
    """The board as an image, `scale` px per m; rounding moves an edge by half a pixel at most."""
    width, height = (round(scale * edge) for edge in board.size)
    image = np.full((height, width), WHITE, np.uint8)
    markers = cv2.aruco.getPredefinedDictionary(dictionary)
    for number, corners in board.corners.items():
        x, y = np.round(
            scale * (corners[0, :2] * [1, -1] + np.array(board.size) / 2)
        ).astype(int)
        side = round(scale * float(corners[1, 0] - corners[0, 0]))
        image[y : y + side, x : x + side] = cv2.aruco.generateImageMarker(
            markers, number, side
        )
    return image


def print_of(board: Board, dictionary: int) -> GreyImage:
    """The board as an image with PRINT_CELL px a cell, edges exact to a FINER of a pixel."""
    corners = next(iter(board.corners.values()))
    # with the black border
    cells = cv2.aruco.getPredefinedDictionary(dictionary).markerSize + 2
    scale = PRINT_CELL * cells / float(corners[1, 0] - corners[0, 0])
    return np.asarray(
        cv2.resize(
            image_of(board, dictionary, FINER * scale),
            [round(scale * edge) for edge in board.size],
            interpolation=cv2.INTER_AREA,
        ),
        np.uint8,
    )


ACCURATE = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-9)
CERTAIN = 5.0  # error of the second pose over the first's from which it is not refined


@dataclass(frozen=True)
class BoardPose:
    """Pose of a board in the optical frame."""

    transform: Transform
    covariance: Array  # (6, 6) of the position (m) and of the rotation vector in the optical frame
    # (6, 6) the same by the camera's calibration; zero: not known
    calibration: Array
    error: float  # RMS distance of the corners from where they should be, of focal length one
    other: BoardPose | None = None  # the second pose of the plane
    # its error over this one's; infinite if there is none
    ratio: float = np.inf


def board_poses(
    points: Array, rays: Array, noise: float, camera: Camera | None = None
) -> BoardPose | None:
    """The pose from corners (n, 3), m in the board's plane z = 0, and their rays (n, 2).

    noise: smallest standard deviation of a ray's coordinate. camera: whose rays they are, for the
    effect of its calibration. None if no pose is found with the board before the camera.
    """
    try:
        count, turns, places, given = cv2.solvePnPGeneric(
            points,
            rays[:, None],
            np.eye(3),
            np.zeros(5),
            flags=cv2.SOLVEPNP_IPPE,
        )
    except cv2.error:
        return None
    errors = np.ravel(given)
    tried = (
        1
        if count > 1 and errors[1] > CERTAIN * max(errors[0], noise)
        else count
    )
    refined = (
        _refined(turn, place, points, rays)
        for turn, place in zip(turns[:tried], places[:tried])
    )
    found = sorted(filter(None, refined), key=lambda item: item[0])
    if not found:
        return None
    spread = np.zeros((2 * len(rays), 2 * len(rays)))
    if camera is not None and camera.covariance is not None:
        slopes = camera.ray_slopes(rays)
        spread = slopes @ camera.covariance @ slopes.T
    first, *others = (_board_pose(*item, noise, spread) for item in found)
    if others and _angle(others[0].transform, first.transform) > 1e-3:
        return replace(
            first,
            other=others[0],
            ratio=others[0].error / max(first.error, noise),
        )
    return first


def _board_pose(
    error: float,
    transform: Transform,
    jacobian: Array,
    noise: float,
    spread: Array,
) -> BoardPose:
    """The pose with the covariances of its error and of the rays' spread (2n, 2n)."""
    count, inverse = len(jacobian), np.linalg.inv(jacobian.T @ jacobian)
    deviation = max(
        noise, error * np.sqrt(count / max(count - 6, 1)) / np.sqrt(2)
    )
    gain = inverse @ jacobian.T
    return BoardPose(
        transform, deviation**2 * inverse, gain @ spread @ gain.T, error
    )


def _refined(
    turn: NDArray[Any], place: NDArray[Any], points: Array, rays: Array
) -> tuple[float, Transform, Array] | None:
    """RMS error, pose and Jacobian (2n, 6) at the least error near a pose; None without one.

    turn: (3, 1) rotation vector; place: (3, 1) m. The Jacobian is by position and by a small turn
    of q = R X about the axes of the optical frame: at a rotation vector of zero OpenCV's derivative
    by it is this one.
    """
    pinhole = np.eye(3)
    turn, place = map(
        np.asarray,
        cv2.solvePnPRefineLM(
            points, rays[:, None], pinhole, None, turn, place, ACCURATE
        ),
    )
    pose = Transform(
        np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.ravel(place)
    )
    turned = points @ pose.rotation.T
    seen, slopes = cv2.projectPoints(turned, np.zeros(3), place, pinhole, None)
    residual = np.ravel(seen) - rays.ravel()
    jacobian = np.concatenate([slopes[:, 3:6], slopes[:, :3]], axis=1)
    in_front = (turned[:, 2] + pose.position[2] > 0).all()
    if (
        not (in_front and np.isfinite(residual).all())
        or np.linalg.cond(jacobian.T @ jacobian) > 1e14
    ):
        return None
    return float(np.sqrt(2 * np.mean(residual**2))), pose, jacobian


def _angle(a: Transform, b: Transform) -> float:
    """Angle between two attitudes, rad."""
    return float(
        np.arccos(np.clip((np.vdot(a.rotation, b.rotation) - 1) / 2, -1.0, 1.0))
    )


def nearest(pose: BoardPose, expected: Transform) -> BoardPose:
    """Of the two poses the one whose attitude is nearer to an expected one."""
    return min(
        (pose, pose.other) if pose.other else (pose,),
        key=lambda each: _angle(each.transform, expected),
    )
