"""Boards and markers to print, at their true size.

A sheet is a grey image of `dots` px per m. A PDF or PNG carries its resolution, so that a
printer which does not scale gives the true size; a line of known length below the sheet
tells whether it did.
"""

import argparse

import cv2
import numpy as np
from PIL import Image

from slot_core.command_line import ProgressLine
from slot_core.config import ConfigError
from slot_core.refusal import quoted
from slot_core.vision.board import (
    WHITE,
    GreyImage,
    image_of,
    make_board,
    single_marker,
)
from slot_core.vision.settings import VisionSettings, read_vision
from slot_lab.desk_command import Outcome
from slot_lab.film.calibration import chessboard

INCH = 0.0254  # m
SCALE = 0.1  # m, of the line to measure
COLUMNS = 4  # single markers beside each other


def run(options: argparse.Namespace, progress: ProgressLine) -> Outcome:
    """Write the sheet; returns a line with its size. Raises ConfigError, OSError."""
    progress("drawing")
    what, dpi = options.what, options.dpi
    dots = dpi / INCH  # px per m
    sheet = with_scale(sheet_of(what, read_vision(), dots), what, dots)
    Image.fromarray(sheet).save(options.out, dpi=(dpi,) * 2, resolution=dpi)
    height, width = (1e3 * edge / dots for edge in sheet.shape)
    return [
        f"{options.out}: {width:.0f} x {height:.0f} mm at {dpi} dots per inch"
    ], 0


def sheet_of(what: str, settings: VisionSettings, dots: float) -> GreyImage:
    """Image of a sheet, `dots` px per m; raises ConfigError for an unknown name."""
    number = settings.dictionary_number
    if what == "chessboard":
        board = settings.chessboard
        return np.asarray(
            chessboard(settings).generateImage(
                [
                    round(dots * board.square * n)
                    for n in (board.columns, board.rows)
                ]
            ),
            np.uint8,
        )
    if what == "points":
        size = settings.points.size
        markers = [
            _named(image_of(single_marker(i, size), number, dots), name, dots)
            for i, name in settings.points.names.items()
        ]
        markers += [np.full_like(markers[0], WHITE)] * (-len(markers) % COLUMNS)
        return np.vstack(
            [
                np.hstack(markers[k : k + COLUMNS])
                for k in range(0, len(markers), COLUMNS)
            ]
        )
    if what not in settings.boards:
        raise ConfigError(
            f"NAME = {quoted(what)}: expected one of"
            f" {', '.join([*settings.boards, 'points', 'chessboard'])}"
        )
    return image_of(make_board(settings.boards[what]), number, dots)


def with_scale(sheet: GreyImage, name: str, dots: float) -> GreyImage:
    """The sheet with white around it, and below it a line of SCALE with its name.

    The margin is 5 mm, the foot with line and text 12 mm high.
    """
    edge, height, width = round(0.005 * dots), *sheet.shape
    foot = round(0.012 * dots)
    y, length = height + 2 * edge, round(SCALE * dots)
    page = np.full((y + foot, max(width, length) + 2 * edge), WHITE, np.uint8)
    page[edge : edge + height, edge : edge + width] = sheet
    page[y : y + max(1, edge // 10), edge : edge + length] = 0
    _write(
        page,
        f"{name}: this line is {1e3 * SCALE:.0f} mm long",
        (edge, y + round(0.008 * dots)),
        0.003 * dots,
    )
    return page


def _named(marker: GreyImage, name: str, dots: float) -> GreyImage:
    """A marker with its name above it."""
    page = np.vstack(
        [
            np.full((round(0.006 * dots), marker.shape[1]), WHITE, np.uint8),
            marker,
        ]
    )
    _write(
        page, name, (round(0.003 * dots), round(0.006 * dots)), 0.0025 * dots
    )
    return page


def _write(
    page: GreyImage, text: str, place: tuple[int, int], height: float
) -> None:
    """Write text of a height, px, at the left end of its base line."""
    scale = height / 21.0  # px of a capital at scale one
    cv2.putText(
        page,
        text,
        place,
        cv2.FONT_HERSHEY_SIMPLEX,
        scale,
        0,
        max(1, int(scale)),
    )
