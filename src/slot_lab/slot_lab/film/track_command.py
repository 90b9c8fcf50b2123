"""Tracks the markers on torso and legs through a film and writes where they are.

FILM is a video, a folder of images, or a bag with images. The CSV has a comment with the frame
and the columns time (s), point, x, y, z (m): a row for each marker that an image shows. Points are
torso, FL_base, FL_third, FL_two_thirds, FL_tip and so on; with --leg those of that leg are base,
third, two_thirds, tip. The camera has to stand still. Where it sees a board that config/vision.yaml
places in odom, the tracks are in odom, else in the camera's own axes: x forward, y left, z up.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import command_parser, require_directory, show, within
from slot_core.names import LEGS
from slot_core.progress import ProgressLine
from slot_core.refusal import InputError
from slot_lab.bags.topics import IMAGES


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/validate --track`; exit code 2 for what cannot be tracked."""
    parser = _parser()
    options = parser.parse_args(arguments)
    require_directory(parser, options.out)
    from slot_lab.film.track import track  # noqa: PLC0415 - heavy

    try:
        with ProgressLine(parser.prog) as progress:
            lines = track(options, progress)
    except InputError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"--out {options.out}: {error.strerror}")
    return 0 if show(parser.prog, lines) else 2


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("validate --track", __doc__)
    add = parser.add_argument
    add("film", type=Path, metavar="RECORDING", help="video, folder of images, or bag")
    add("--out", type=Path, metavar="FILE", required=True, help="file to write")
    add(
        "--camera",
        type=Path,
        metavar="FILE",
        help="calibration; default: that in the bag",
    )
    add("--leg", choices=LEGS, help="write the torso and this leg only")
    depth = "folder of 16-bit depth images (mm) registered to the images, or topic of the bag"
    add("--depth", default="", metavar="DIR|NAME", help=depth)
    topic = f"topic of the bag (default: {IMAGES})"
    add("--topic", default=IMAGES, metavar="NAME", help=topic)
    rate = "images per second (default: the video's own; 30 for a folder)"
    add("--rate", type=within(0.1, 10000.0), metavar="HZ", help=rate)
    return parser


if __name__ == "__main__":
    sys.exit(main())
