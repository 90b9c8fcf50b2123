"""Films a recorded walk with a synthetic camera beside the robot, to try scripts/track with.

WHAT is a recording of scripts/run. The film shows the markers on torso and legs and the board
behind the robot, as config/vision.yaml places them, from `film_camera`. With the word chessboard
the result is a folder of images of the ChArUco board, for scripts/calibrate_camera. Both are
synthetic: distortion, blur and noise are added to rendered images, and nothing in them was
measured.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from slot_core.command_line import command_parser, require_directory, show, within
from slot_core.progress import ProgressLine
from slot_core.refusal import InputError


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/film`; one line and exit code 2 for a bag that cannot be filmed."""
    parser = _parser()
    options = parser.parse_args(arguments)
    require_directory(parser, options.out)
    from slot_lab.film.film import film  # noqa: PLC0415 - heavy

    try:
        with ProgressLine(parser.prog) as progress:
            count = film(options, partial(progress, "filming"))
    except InputError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename}: {error.strerror}")
    return 0 if show(parser.prog, [f"{count} images in {options.out}"]) else 2


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("film", __doc__)
    add = parser.add_argument
    add("what", metavar="BAG", help="recording of scripts/run, or the word chessboard")
    add("--out", type=Path, metavar="FILE", required=True, help="video (.avi), or folder")
    add("--depth", type=Path, metavar="DIR", help="also write depth images (mm, 16 bit)")
    add("--truth", type=Path, metavar="FILE", help="also write the true tracks")
    duration = "length of the film, s (default: 6)"
    add("--duration", type=within(0.1, 3600.0, "s"), default=6.0, metavar="S", help=duration)
    add("--seed", metavar="N", type=int, default=0, help="of the noise (default: 0)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
