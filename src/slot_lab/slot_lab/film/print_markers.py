"""Writes the boards and markers of config/vision.yaml to print at their true size.

WHAT is a board of vision.yaml (wall, torso, ...), points for the single markers of torso and legs,
or chessboard for the ChArUco board of scripts/calibrate_camera. A PDF has the true size if it is
printed at 100 %, without fitting to the page; measure the line that is printed with it. A PNG has
its resolution in the file.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from slot_core.command_line import command_parser, show, within
from slot_core.config import ConfigError
from slot_core.refusal import quoted
from slot_core.vision.board import WHITE, GreyImage, image_of, make_board, single_marker
from slot_core.vision.settings import VisionSettings, read_vision
from slot_lab.film.calibration import chessboard

INCH = 0.0254  # m
SCALE = 0.1  # m, of the line to measure
FORMATS = (".png", ".pdf")
COLUMNS = 4  # single markers beside each other


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/print_markers`; one line and exit code 2 for a wrong argument."""
    parser = _parser()
    options = parser.parse_args(arguments)
    dots = options.dpi / INCH  # px per m
    if options.out.suffix.lower() not in FORMATS:
        parser.error(f"--out {options.out}: the name of a print ends in {' or '.join(FORMATS)}")
    try:
        sheet = with_scale(sheet_of(options.what, read_vision(), dots), options.what, dots)
        Image.fromarray(sheet).save(options.out, dpi=(options.dpi,) * 2, resolution=options.dpi)
    except ConfigError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"--out {options.out}: {error.strerror or error}")
    height, width = (1e3 * edge / dots for edge in sheet.shape)
    size = f"{width:.0f} x {height:.0f} mm at {options.dpi} dots per inch"
    return 0 if show(parser.prog, [f"{options.out}: {size}"]) else 2


def sheet_of(what: str, settings: VisionSettings, dots: float) -> GreyImage:
    """What is printed, `dots` px per m; raises ConfigError for an unknown name."""
    number = settings.dictionary_number
    if what == "chessboard":
        board = settings.chessboard
        size = [round(dots * board.square * n) for n in (board.columns, board.rows)]
        return np.asarray(chessboard(settings).generateImage(size), np.uint8)
    if what == "points":
        markers = [
            _named(image_of(single_marker(i, settings.points.size), number, dots), name, dots)
            for i, name in settings.points.names.items()
        ]
        blank = np.full_like(markers[0], WHITE)
        rows = math.ceil(len(markers) / COLUMNS)
        markers += [blank] * (rows * COLUMNS - len(markers))
        return np.vstack([np.hstack(markers[COLUMNS * r : COLUMNS * (r + 1)]) for r in range(rows)])
    if what not in settings.boards:
        known = ", ".join([*settings.boards, "points", "chessboard"])
        raise ConfigError(f"WHAT = {quoted(what)}: expected one of {known}")
    return image_of(make_board(settings.boards[what]), number, dots)


def with_scale(sheet: GreyImage, name: str, dots: float) -> GreyImage:
    """The sheet with white around it, and below it a line of SCALE with its name."""
    edge, height, width = round(0.005 * dots), *sheet.shape
    foot = round(0.012 * dots)
    y, length = height + 2 * edge, round(SCALE * dots)
    page = np.full((y + foot, max(width, length) + 2 * edge), WHITE, np.uint8)
    page[edge : edge + height, edge : edge + width] = sheet
    page[y : y + max(1, edge // 10), edge : edge + length] = 0
    text = f"{name}: this line is {1e3 * SCALE:.0f} mm long"
    _write(page, text, (edge, y + round(0.008 * dots)), 0.003 * dots)
    return page


def _named(marker: GreyImage, name: str, dots: float) -> GreyImage:
    """A marker with its name above it."""
    page = np.vstack([np.full((round(0.006 * dots), marker.shape[1]), WHITE, np.uint8), marker])
    _write(page, name, (round(0.003 * dots), round(0.006 * dots)), 0.0025 * dots)
    return page


def _write(page: GreyImage, text: str, place: tuple[int, int], height: float) -> None:
    """Write text of a height, px, at the left end of its base line."""
    scale = height / 21.0  # px of a capital at scale one
    cv2.putText(page, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, 0, max(1, int(scale)))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("print_markers", __doc__)
    add = parser.add_argument
    add("what", metavar="NAME", help="name of a board, points, or chessboard")
    add("--out", type=Path, metavar="FILE", required=True, help="PNG or PDF to write")
    dots = "dots per inch (default: 300)"
    add("--dpi", type=within(50, 1200), default=300, metavar="N", help=dots)
    return parser


if __name__ == "__main__":
    sys.exit(main())
