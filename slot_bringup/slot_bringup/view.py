"""Shows a run: the robot with its bent legs, forces and plots on the robot's time line.

In rerun, or with --html as one page for any browser.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import signal
import subprocess
import sys
import tempfile
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from slot_bringup import interrupts
from slot_core.command_line import command_parser, refuse, show
from slot_core.progress import ProgressLine
from slot_core.refusal import InputError

if TYPE_CHECKING:
    from slot_bringup.rerun_log import RerunLog
    from slot_bringup.rerun_viewer import Viewer
    from slot_lab.bags.bag import Bag

BAGS = Path("bags")  # where scripts/run keeps them
QUEUE = 100  # messages of a topic that wait while others are drawn
STOP_TIMEOUT = 10.0  # s, from SIGTERM to SIGKILL


class ViewError(InputError):
    """A run cannot be shown; the message is one line."""


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line; a wrong value exits with code 2 and one line."""
    parser = command_parser("view", __doc__)
    add = parser.add_argument
    which = "directory of a bag (default: the newest in bags/); two of them with --html"
    add("bags", nargs="*", type=Path, metavar="BAG", help=which)
    add("--live", action="store_true", help="show a running graph, not a bag")
    add("--namespace", metavar="NAME", default="", help="of the graph")
    out = parser.add_mutually_exclusive_group()
    out.add_argument("--web", action="store_true", help="in a browser (default: in a window)")
    out.add_argument("--save", type=Path, metavar="FILE", help="only write a file that rerun opens")
    page = "only write a page that needs nothing else: offline, on a phone, without rerun"
    out.add_argument("--html", type=Path, metavar="FILE", help=page)
    moving = "only write two strides as a GIF, PNG or WebP that moves; needs no rerun"
    out.add_argument("--animate", type=Path, metavar="FILE", help=moving)
    add("--no-browser", action="store_true", help="with --web: print the address, open nothing")
    options = parser.parse_args(arguments)
    if options.live and (options.bags or options.animate or options.html):
        parser.error("--live: shows a running graph, not a bag")
    if len(options.bags) > (2 if options.html else 1):
        parser.error(f"{len(options.bags)} bags: expected one, or two with --html")
    if options.no_browser and not options.web:
        parser.error("--no-browser: only with --web")
    return options


def view(options: argparse.Namespace) -> None:
    """Show or write what the options ask for.

    Raises InputError, ViewerError, OSError.
    """
    from slot_bringup.check import check_place  # noqa: PLC0415 - heavy
    from slot_lab.bags.bag import Bag  # noqa: PLC0415

    check_place(options.namespace)
    paths = [] if options.live else options.bags or [newest_bag(BAGS)]
    bags = [Bag(path, options.namespace) for path in paths]
    if options.html:
        from slot_lab.report.run_page.run_page import write_page  # noqa: PLC0415 - heavy

        with ProgressLine("scripts/view") as progress:
            lines = write_page(bags, options.html, progress)
        if not show("scripts/view", lines):
            raise SystemExit(2)
        return
    bag = bags[0] if bags else None
    if options.animate and bag:
        from slot_lab.report.animation import animate  # noqa: PLC0415 - heavy

        with ProgressLine("scripts/view") as progress:
            animate(bag, options.animate, partial(progress, "drawing"))
        return
    require_rerun()
    if options.save:
        _save(bag, options)
        return
    if not (options.web or has_display()):
        raise ViewError("no display: use --web for a browser, or --save FILE.rrd")
    with tempfile.TemporaryDirectory() as scratch:
        if bag:
            _show_bag(bag, options, Path(scratch))
        else:
            _show_live(options, Path(scratch))


def require_rerun() -> None:
    """Raise ViewError unless rerun is installed."""
    if importlib.util.find_spec("rerun") is None:
        raise ViewError("rerun-sdk is missing; run scripts/setup --view")


def has_display() -> bool:
    """Whether a window can be opened."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def newest_bag(directory: Path) -> Path:
    """The bag in a directory that was changed last; raises ViewError if there is none."""
    from slot_lab.bags.bag import STORAGES  # noqa: PLC0415 - heavy

    files = [path for suffix in STORAGES for path in directory.glob(f"*/*{suffix}")]
    bags = {path.parent for path in files}
    if not bags:
        raise ViewError(f"no bag in {directory.absolute()}: name one, or make one by scripts/run")
    return max(bags, key=lambda path: path.stat().st_mtime)


def _save(bag: Bag | None, options: argparse.Namespace) -> None:
    from slot_bringup import rerun_log  # noqa: PLC0415 - optional

    if bag:
        _log_bag(bag, options.save)
    else:
        _follow(options.namespace, rerun_log.to_file(options.save), lambda: False)


def _show_bag(bag: Bag, options: argparse.Namespace, scratch: Path) -> None:
    """Show a bag until the window is closed, or in a browser until an interrupt."""
    recording = scratch / f"{bag.path.absolute().name}.rrd"
    _log_bag(bag, recording)
    with _started(options, scratch, recording) as viewer:
        viewer.wait()


def _show_live(options: argparse.Namespace, scratch: Path) -> None:
    """Show a running graph until an interrupt, or until the window is closed."""
    from slot_bringup import rerun_log  # noqa: PLC0415 - optional

    with _started(options, scratch, None) as viewer:
        log = rerun_log.to_viewer(viewer.address)
        _follow(options.namespace, log, lambda: viewer.closed)


@contextmanager
def _started(
    options: argparse.Namespace, scratch: Path, recording: Path | None
) -> Iterator[Viewer]:
    """Start the viewer and end it, but for the window of a live run, which has what it got."""
    from slot_bringup.rerun_viewer import Viewer  # noqa: PLC0415 - heavy

    viewer = Viewer(web=options.web, log=scratch / "viewer.log", recording=recording)
    try:
        if options.web:
            print(f"{viewer.page}\nCtrl-C ends it", flush=True)
        if options.web and has_display() and not options.no_browser:
            webbrowser.open(viewer.page)
        yield viewer
    finally:
        if options.web or not options.live:
            viewer.stop()


def _log_bag(bag: Bag, path: Path) -> None:
    """Write a bag as a recording of rerun; raises BagError if it has nothing that is shown."""
    from slot_bringup import rerun_log  # noqa: PLC0415 - optional
    from slot_core.recording.bag_error import BagError  # noqa: PLC0415 - heavy

    known = rerun_log.RerunLog.TOPICS
    topics = [topic for topic in known if bag.counts.get(topic)]
    if not topics:
        raise BagError(f"{bag.path}: holds none of {', '.join(known)}")
    with rerun_log.to_file(path) as log:
        for topic, _, message in bag.merged(*topics):
            log.receive(topic, message)


def _follow(namespace: str, log: RerunLog, ended: Callable[[], bool]) -> None:
    """Log the messages of a running graph until `ended`, or an interrupt."""
    from slot_bringup.monitor import listener  # noqa: PLC0415 - heavy
    from slot_core.recording.record_settings import read_record_settings  # noqa: PLC0415
    from slot_nodes import messages, qos  # noqa: PLC0415

    with log, listener("view", namespace) as (node, executor):
        for name, topic in read_record_settings().topics.items():
            if name not in log.TOPICS:
                continue
            node.create_subscription(
                messages.message_class(topic.type),
                name.removeprefix("/"),
                partial(log.receive, name),
                qos.best_effort(qos.recorded(topic, QUEUE)),
            )
        while not ended():
            executor.spin_once()


@contextmanager
def live_viewer(namespace: str) -> Iterator[None]:
    """Show a graph live while the block runs, in a process of its own; its errors end only it."""
    from slot_bringup.graph import TIED  # noqa: PLC0415 - heavy

    command = [*TIED, sys.executable, "-P", "-m", "slot_bringup.view", "--live"]
    command += ["--namespace", namespace, *([] if has_display() else ["--web"])]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `scripts/view`; returns the exit code."""
    options = parse(arguments)
    from slot_bringup.rerun_viewer import ViewerError  # noqa: PLC0415 - heavy

    try:
        with interrupts.on_interrupt(signal.default_int_handler):
            view(options)
    except (InputError, ViewerError) as error:
        refuse("scripts/view", error)
        return 2
    except OSError as error:
        refuse("scripts/view", f"{error.filename}: {error.strerror}")
        return 2
    except KeyboardInterrupt:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
