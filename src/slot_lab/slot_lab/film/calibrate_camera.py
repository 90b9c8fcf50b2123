"""Calibrates a camera from images of the ChArUco board: OpenCV's procedure, wrapped.

Print the board (scripts/calibrate --print chessboard --out chessboard.pdf), glue it to something
flat, and film it: near and far, in all corners of the image, tilted by up to 45 degrees to every
side, 20 to 40 views. RECORDING is a folder of images, a video, or a bag. The file has the format of ROS's
camera_info and, beside it, the covariance of the calibration, which enters every pose's.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import command_parser, positive_integer
from slot_lab.bags.topics import IMAGES
from slot_lab.desk_command import run_command


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/calibrate --camera`; exit code 2 for unusable views."""
    parser = command_parser("calibrate --camera", __doc__)
    add = parser.add_argument
    add(
        "film",
        type=Path,
        metavar="RECORDING",
        help="folder of images, video, or bag",
    )
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
    add(
        "--every",
        type=positive_integer,
        default=1,
        metavar="N",
        help="use every Nth image only, of a video for example every 15th (default: 1)",
    )
    add(
        "--topic",
        default=IMAGES,
        metavar="NAME",
        help=f"topic of the bag (default: {IMAGES})",
    )
    options = parser.parse_args(arguments)
    from slot_lab.film.calibration import run  # noqa: PLC0415 - heavy

    return run_command(parser, options, run)


if __name__ == "__main__":
    sys.exit(main())
