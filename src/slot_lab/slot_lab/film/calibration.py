"""Camera calibration by OpenCV's procedure for a ChArUco board: views, then calibrateCamera."""

import argparse
import math
from dataclasses import dataclass

import cv2
import numpy as np

from slot_core.arrays import Array
from slot_core.command_line import ProgressLine
from slot_core.vision.board import GreyImage
from slot_core.vision.camera import Camera, CameraError, camera_text
from slot_core.vision.settings import VisionSettings, read_vision
from slot_lab.desk_command import Outcome
from slot_lab.film.images import FilmError, read_film, silence_opencv

NAMES = ("f_x", "f_y", "c_x", "c_y", "k1", "k2", "p1", "p2", "k3")
CORNERS_MIN = 8  # of a view that counts
VIEWS_MIN = 8
COVERED_MIN = 0.5  # share of the image's width and height that the corners span
# px, RMS: beyond it the board is bent or has another size ratio
ERROR_MAX = 1.0
# times the median error of the views, beyond which a view is left out
GROSS = 3.0


@dataclass(frozen=True)
class BoardView:
    """Corners of the board in one image."""

    name: str
    points: Array  # (n, 3) m on the board
    pixels: Array  # (n, 2) px


@dataclass(frozen=True)
class Calibration:
    """A calibrated camera, and how well it explains the views."""

    camera: Camera
    error: float  # px, RMS of the reprojection
    errors: dict[str, float]  # px, of each view used, by name
    left_out: tuple[str, ...]  # views with gross errors
    # share of the width and height that the corners span
    covered: tuple[float, float]


def run(options: argparse.Namespace, progress: ProgressLine) -> Outcome:
    """Calibrate from the views of a film and write the file; returns lines on it.

    Raises FilmError, CameraError, ConfigError, OSError.
    """
    silence_opencv()
    board, size = chessboard(read_vision()), (0, 0)
    views: list[BoardView] = []
    for number, frame in enumerate(
        read_film(options.film, topic=options.topic)
    ):
        progress(f"image {number}")
        shape = frame.grey.shape[1], frame.grey.shape[0]
        if number and shape != size:
            raise FilmError(
                f"{options.film}: image {number} has another size: {shape}, {size}"
            )
        size = shape
        if number % options.every == 0:
            view = find_view(board, f"image {number}", frame.grey)
            views += [view] if view else []
    progress("calibrating")
    found = calibrate(views, size)
    options.out.write_text(camera_text(found.camera, options.name))
    return [*report(found), f"wrote {options.out}"], 0


def report(found: Calibration) -> list[str]:
    """Lines: error, parameters with their standard deviations, and what the views cover."""
    camera = found.camera
    values = [*camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *camera.distortion]
    worst = max(found.errors, key=lambda name: found.errors[name])
    left_out = f"left out for gross errors: {', '.join(found.left_out)}"
    assert camera.covariance is not None
    variances = camera.covariance.diagonal()
    return [
        f"{len(found.errors)} views, reprojection error {found.error:.3f} px"
        f" (largest {found.errors[worst]:.3f} px, {worst})",
        f"corners span {100 * found.covered[0]:.0f} % of the width,"
        f" {100 * found.covered[1]:.0f} % of the height",
        *([left_out] if found.left_out else []),
        *(
            f"{name:<4} {value:10.4f} +- {math.sqrt(variance):.4f}"
            for name, value, variance in zip(NAMES, values, variances)
        ),
    ]


def chessboard(settings: VisionSettings) -> cv2.aruco.CharucoBoard:
    """The ChArUco board of the settings."""
    board = settings.chessboard
    return cv2.aruco.CharucoBoard(
        (board.columns, board.rows),
        board.square,
        board.marker,
        cv2.aruco.getPredefinedDictionary(settings.dictionary_number),
    )


def find_view(
    board: cv2.aruco.CharucoBoard, name: str, image: GreyImage
) -> BoardView | None:
    """The board's corners in a grey image; None if fewer than CORNERS_MIN are found."""
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
    if ids is None or len(ids) < CORNERS_MIN:
        return None
    places = np.asarray(board.getChessboardCorners(), np.float64)
    return BoardView(
        name,
        places[np.asarray(ids).ravel()],
        np.asarray(corners, np.float64).reshape(-1, 2),
    )


def calibrate(views: list[BoardView], size: tuple[int, int]) -> Calibration:
    """The camera of `size` (px) from at least VIEWS_MIN views; raises CameraError.

    Views whose error is GROSS times the median are left out once. Raises also if the corners do not
    span COVERED_MIN of the image, and for an error beyond ERROR_MAX.
    """
    if len(views) < VIEWS_MIN:
        raise CameraError(
            f"{len(views)} images show the board, at least {VIEWS_MIN} are needed"
        )
    corners = np.vstack([view.pixels for view in views])
    width, height = (np.ptp(corners, axis=0) / size).tolist()
    if min(width, height) < COVERED_MIN:
        raise CameraError(
            f"the board covers {100 * width:.0f} % of the width and {100 * height:.0f} %"
            f" of the height in all images together, at least {100 * COVERED_MIN:.0f} % are"
            " needed"
        )
    *_, errors = _solve(views, size)
    kept = [v for v, e in zip(views, errors) if e <= GROSS * np.median(errors)]
    if len(kept) < VIEWS_MIN:
        kept = views
    error, matrix, distortion, covariance, errors = _solve(kept, size)
    if error > ERROR_MAX:
        raise CameraError(
            f"reprojection error {error:.2f} px, limit {ERROR_MAX:g} px: is the board flat, and"
            " printed as in vision.yaml?"
        )
    names = [view.name for view in kept]
    return Calibration(
        Camera(*size, matrix, distortion, covariance),
        error,
        dict(zip(names, errors.tolist())),
        tuple(view.name for view in views if view.name not in names),
        (width, height),
    )


def _solve(
    views: list[BoardView], size: tuple[int, int]
) -> tuple[float, Array, Array, Array, Array]:
    """RMS error, K, distortion (5,), their covariance (9, 9) and the errors of the views."""
    points = [view.points.astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    try:
        found = cv2.calibrateCameraExtended(
            points, pixels, size, np.eye(3), np.zeros(5)
        )
    except cv2.error as problem:
        raise CameraError(f"OpenCV finds no camera: {problem.err}") from None
    error, matrix, distortion, turns, places, *_, errors = found
    k = np.asarray(matrix, np.float64)
    d = np.asarray(distortion, np.float64).ravel()[:5]
    poses = [*zip(*(np.asarray(part, np.float64) for part in (turns, places)))]
    return (
        float(error),
        k,
        d,
        _covariance(views, poses, k, d, float(error)),
        np.asarray(errors, np.float64).ravel(),
    )


def _covariance(
    views: list[BoardView],
    poses: list[tuple[Array, Array]],
    matrix: Array,
    distortion: Array,
    error: float,
) -> Array:
    """Covariance (9, 9) of f_x f_y c_x c_y k1 k2 p1 p2 k3, whatever the poses of the views.

    With the derivatives A by a view's pose and B by the parameters, and the variance s^2 of a
    coordinate: s^2 (sum B^T B - B^T A (A^T A)^-1 A^T B)^-1.
    """
    normal = np.zeros((9, 9))
    for view, (turn, place) in zip(views, poses):
        _, slopes = cv2.projectPoints(
            view.points, turn, place, matrix, distortion
        )
        pose, parameters = np.split(np.asarray(slopes, np.float64), [6], axis=1)
        free = (
            parameters - pose @ np.linalg.lstsq(pose, parameters, rcond=None)[0]
        )
        normal += free.T @ free
    count = 2 * sum(len(view.pixels) for view in views)
    variance = count * error**2 / 2 / max(count - 9 - 6 * len(views), 1)
    scale = 1 / np.sqrt(np.diag(normal))  # px beside coefficients of distortion
    try:
        inverse = np.linalg.inv(scale[:, None] * normal * scale)
    except np.linalg.LinAlgError:
        raise CameraError(
            "the views do not determine the camera: tilt the board"
        ) from None
    return np.asarray(variance * scale[:, None] * inverse * scale)
