"""Tracks the markers on torso and legs through a film and writes where they are.

RECORDING is a video, a folder of images, or a bag with images. The CSV has a comment with the frame
and the columns time (s), point, x, y, z (m): a row for each marker that an image shows. Points are
torso, FL_base, FL_third, FL_two_thirds, FL_tip and so on; with --leg the leg's are base, third,
two_thirds, tip. The camera has to stand still. Where it sees a board that config/vision.yaml
places in odom, the tracks are in odom, else in the camera's own axes: x forward, y left, z up.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import command_parser, require_directory, within
from slot_core.names import LEGS
from slot_lab.bags.topics import IMAGES
from slot_lab.desk_command import run_command


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/validate --track`; exit code 2 for what cannot be tracked."""
    parser = command_parser("validate --track", __doc__)
    add = parser.add_argument
    add(
        "film",
        type=Path,
        metavar="RECORDING",
        help="video, folder of images, or bag",
    )
    add("--out", type=Path, metavar="FILE", required=True, help="file to write")
    add(
        "--camera",
        type=Path,
        metavar="FILE",
        help="calibration (default: of the bag)",
    )
    add("--leg", choices=LEGS, help="write the torso and this leg only")
    add(
        "--topic",
        default=IMAGES,
        metavar="NAME",
        help=f"topic of the bag (default: {IMAGES})",
    )
    add(
        "--rate",
        type=within(0.1, 10000.0),
        metavar="HZ",
        help="images per second (default: the video's own; 30 for a folder)",
    )
    options = parser.parse_args(arguments)
    require_directory(parser, options.out)
    from slot_lab.film.tracker import run  # noqa: PLC0415 - heavy

    return run_command(parser, options, run)


if __name__ == "__main__":
    sys.exit(main())
