"""Calibrates a camera from images of the ChArUco board: OpenCV's procedure, wrapped.

Print the board (scripts/calibrate --print chessboard --out chessboard.pdf), glue it to something
flat, and film it: near and far, in all corners of the image, tilted by up to 45 degrees to every
side, 20 to 40 views. FILM is a folder of images, a video, or a bag. The file has the format of ROS's
camera_info and, beside it, the covariance of the calibration, which enters that of every pose.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from slot_core.command_line import command_parser, positive_integer, show
from slot_core.progress import ProgressLine
from slot_core.refusal import InputError
from slot_lab.bags.topics import IMAGES

if TYPE_CHECKING:
    from slot_lab.film.calibration import BoardView, Calibration

NAMES = ("f_x", "f_y", "c_x", "c_y", "k1", "k2", "p1", "p2", "k3")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/calibrate --camera`; one line and exit code 2 for unusable views."""
    parser = _parser()
    options = parser.parse_args(arguments)
    import cv2  # noqa: PLC0415 - heavy

    from slot_core.vision.camera import camera_text  # noqa: PLC0415

    cv2.utils.logging.setLogLevel(
        cv2.utils.logging.LOG_LEVEL_SILENT
    )  # it repeats our messages
    try:
        with ProgressLine(parser.prog) as progress:
            found = _calibrate(options, progress)
        options.out.write_text(camera_text(found.camera, options.name))
    except InputError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"--out {options.out}: {error.strerror}")
    return 0 if show(parser.prog, [*report(found), f"wrote {options.out}"]) else 2


def _calibrate(options: argparse.Namespace, progress: ProgressLine) -> Calibration:
    from slot_core.vision.settings import read_vision  # noqa: PLC0415 - heavy
    from slot_lab.film.calibration import calibrate, chessboard, find_view  # noqa: PLC0415
    from slot_lab.film.images import FilmError, read_film  # noqa: PLC0415

    board, size = chessboard(read_vision()), (0, 0)
    views: list[BoardView] = []
    frames = read_film(options.film, topic=options.topic)
    for number, frame in enumerate(frames):
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
    return calibrate(views, size)


def report(found: Calibration) -> list[str]:
    """Lines: error, parameters with their standard deviations, and what the views cover."""
    camera = found.camera
    values = [*camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *camera.distortion]
    worst = max(found.errors, key=lambda name: found.errors[name])
    lines = [
        f"{len(found.errors)} views, reprojection error {found.error:.3f} px"
        f" (largest {found.errors[worst]:.3f} px, {worst})",
        f"corners span {100 * found.covered[0]:.0f} % of the width,"
        f" {100 * found.covered[1]:.0f} % of the height",
    ]
    if found.left_out:
        lines.append(f"left out for gross errors: {', '.join(found.left_out)}")
    assert camera.covariance is not None
    variances = camera.covariance.diagonal()
    for name, value, variance in zip(NAMES, values, variances):
        lines.append(f"{name:<4} {value:10.4f} +- {math.sqrt(variance):.4f}")
    return lines


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("calibrate --camera", __doc__)
    add = parser.add_argument
    add("film", type=Path, metavar="RECORDING", help="folder of images, video, or bag")
    add(
        "--out",
        type=Path,
        metavar="FILE",
        required=True,
        help="calibration file to write",
    )
    add(
        "--name",
        default="camera",
        help="name of the camera in the file (default: camera)",
    )
    every = "use every Nth image only, of a video for example every 15th (default: 1)"
    add("--every", type=positive_integer, default=1, metavar="N", help=every)
    topic = f"topic of the bag (default: {IMAGES})"
    add("--topic", default=IMAGES, metavar="NAME", help=topic)
    return parser


if __name__ == "__main__":
    sys.exit(main())
