"""Boards of markers: corners in the board's frame, and their images."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.geometry import Transform
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
