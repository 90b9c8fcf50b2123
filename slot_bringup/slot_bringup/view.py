"""Shows a recorded run as one page for any browser: the robot with its bent legs, forces and plots.

Without --html the page is written into the bag's folder and opened. A running graph is shown by
scripts/play --graph, or by scripts/run --view. scripts/view --map BAG draws the Dynamic Constraint
Map instead; see its --help.
"""

import argparse
import signal
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from slot_bringup import interrupts
from slot_bringup.playing.main_page import open_in_browser
from slot_core.command_line import ProgressLine, command_parser, refuse, show
from slot_core.refusal import InputError

PROGRAM = "scripts/view"
BAGS = Path("bags")  # where scripts/run keeps them
PAGE = "walk.html"  # in the bag's folder, beside walk.png


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line; a wrong value exits with code 2 and one line."""
    parser = command_parser("view", __doc__)
    add = parser.add_argument
    add(
        "bags",
        nargs="*",
        type=Path,
        metavar="BAG",
        help="directory of a bag (default: the newest in bags/); two of them with --html",
    )
    add("--namespace", metavar="NAME", default="", help="of the recorded graph")
    out = parser.add_mutually_exclusive_group()
    out.add_argument(
        "--html",
        type=Path,
        metavar="FILE",
        help=f"only write a page, offline and on a phone too (default: open BAG/{PAGE})",
    )
    out.add_argument(
        "--animate",
        type=Path,
        metavar="FILE",
        help="only write two strides as a GIF, PNG or WebP that moves",
    )
    out.add_argument(
        "--no-browser", action="store_true", help="write the page, open nothing"
    )
    options = parser.parse_args(arguments)
    if len(options.bags) > (2 if options.html else 1):
        parser.error(
            f"{len(options.bags)} bags: expected one, or two with --html"
        )
    return options


def view(options: argparse.Namespace) -> None:
    """Write the page or the picture that the options ask for; open a page without a name.

    Raises InputError, OSError.
    """
    from slot_bringup.check import check_place  # noqa: PLC0415 - heavy
    from slot_lab.bags.bag import Bag  # noqa: PLC0415

    check_place(options.namespace)
    bags = [
        Bag(path, options.namespace)
        for path in options.bags or [newest_bag(BAGS)]
    ]
    if options.animate:
        from slot_lab.report.robot_drawing import animate  # noqa: PLC0415 - heavy

        with ProgressLine(PROGRAM) as progress:
            animate(bags[0], options.animate, partial(progress, "drawing"))
        return
    from slot_lab.report.run_page.run_page import write_page  # noqa: PLC0415 - heavy

    place = bags[0].path
    page = options.html or (place if place.is_dir() else place.parent) / PAGE
    with ProgressLine(PROGRAM) as progress:
        lines = write_page(bags, page, progress)
    if not show(PROGRAM, lines):
        raise SystemExit(2)
    if not options.html and not options.no_browser:
        open_in_browser(page.absolute().as_uri())


def newest_bag(directory: Path) -> Path:
    """The bag in a directory that was recorded last; raises InputError if there is none."""
    from slot_lab.bags.bag import STORAGES  # noqa: PLC0415 - heavy

    files = [
        path for suffix in STORAGES for path in directory.glob(f"*/*{suffix}")
    ]
    if not files:
        raise InputError(
            f"no bag in {directory.absolute()}: name one, or make one by scripts/run"
        )
    return max(files, key=lambda path: path.stat().st_mtime).parent


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `scripts/view`; returns the exit code."""
    options = parse(arguments)
    try:
        with interrupts.on_interrupt(signal.default_int_handler):
            view(options)
    except InputError as error:
        refuse(PROGRAM, error)
        return 2
    except OSError as error:
        refuse(PROGRAM, f"{error.filename}: {error.strerror}")
        return 2
    except KeyboardInterrupt:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
