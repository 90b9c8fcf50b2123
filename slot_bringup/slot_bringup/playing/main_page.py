"""Plays with the simulated robot in the browser: drive it, change it and its world, push it.

The robot, its controller and the page run in this process; with --graph the page drives the graph
that scripts/run runs. The page is for this machine; with --host ADDRESS also for others, which need
the address with the token that is printed.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import signal
import subprocess
import sys
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from slot_bringup.interrupts import on_interrupt
from slot_core.command_line import command_parser, missing, refuse, within
from slot_core.config import ConfigError
from slot_core.control.policies import DEFAULT_POLICY

if TYPE_CHECKING:
    import viser

PROGRAM = "scripts/play"
PORT = 8080
BAGS = Path("bags")
STOP_TIMEOUT = 10.0  # s, from SIGTERM to SIGKILL
GAIT_TIME = 1.0  # s to wait for the present gait of a graph


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line; a wrong value exits with code 2 and one line."""
    made = command_parser("play", __doc__)
    add = made.add_argument
    add("--scene", metavar="NAME", help="of config/scene (default: flat)")
    add("--policy", metavar="NAME", help=f"policy (default: {DEFAULT_POLICY})")
    add("--graph", action="store_true", help="drive a running graph")
    add("--namespace", metavar="NAME", default="", help="of the graph")
    add(
        "--wait",
        default=5.0,
        type=within(0.0, 3600.0, "s"),
        metavar="S",
        help="for the graph to answer (default: %(default)g s)",
    )
    add(
        "--open",
        action="store_true",
        help="open the page in the browser, if there is a display",
    )
    add(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="to listen on (default: 127.0.0.1)",
    )
    add(
        "--port",
        default=PORT,
        type=within(0, 65535),
        metavar="N",
        help="default: %(default)s",
    )
    options = made.parse_args(arguments)
    if options.graph and (options.scene or options.policy):
        made.error("--graph: its scene and policy are those of scripts/run")
    if options.namespace and not options.graph:
        made.error("--namespace: only with --graph")
    return options


def _play_robot(options: argparse.Namespace) -> None:
    from slot_bringup.playing.play_page import PlayPage  # noqa: PLC0415 - needs viser
    from slot_lab.play.played_robot import PlayedRobot  # noqa: PLC0415 - heavy

    robot = PlayedRobot(
        options.scene or "flat", options.policy or DEFAULT_POLICY
    )
    with _served(options) as server:
        PlayPage(server, robot, BAGS).run(lambda: False)


def _play_graph(options: argparse.Namespace) -> None:
    from slot_bringup.check import check_place  # noqa: PLC0415 - heavy
    from slot_bringup.monitor import listener  # noqa: PLC0415 - heavy
    from slot_bringup.operate import no_answer  # noqa: PLC0415
    from slot_bringup.playing.graph_page import GraphPage  # noqa: PLC0415 - needs viser
    from slot_bringup.playing.graph_robot import GraphRobot  # noqa: PLC0415

    check_place(options.namespace)
    with listener("play", options.namespace) as (node, executor):
        robot = GraphRobot(node)
        if not executor.spin_until(robot.found, options.wait):
            raise ConfigError(no_answer(node, "supervisor", options.wait))
        # none before the servos have torque
        executor.spin_until(robot.walks, GAIT_TIME)
        with _served(options) as server:
            GraphPage(server, robot).run(lambda: False, executor.spin_once)


@contextmanager
def _served(options: argparse.Namespace) -> Iterator[viser.ViserServer]:
    """Server of a page, whose address is printed and opened if wanted; raises OSError."""
    from slot_bringup.playing.page_server import served  # noqa: PLC0415 - needs viser

    with served(options.host, options.port) as (server, page):
        print(f"{page}\nCtrl-C ends it", flush=True)
        if options.open:
            open_in_browser(page)
        yield server


@contextmanager
def live_page(namespace: str, wait: float) -> Iterator[None]:
    """Serve the live page of a graph in another process while the block runs.

    The page waits up to a time (s) for the graph to answer. An error of the page ends the page alone.
    """
    from slot_bringup.graph import TIED  # noqa: PLC0415 - heavy

    command = [
        *TIED,
        sys.executable,
        "-P",
        "-m",
        "slot_bringup.playing.main_page",
        "--graph",
        "--namespace",
        namespace,
        "--wait",
        str(wait),
        "--open",
    ]
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, start_new_session=True
    )
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def open_in_browser(address: str) -> None:
    """Open an address in the browser if there is a display to show it on."""
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(address)


def require_viser() -> None:
    """Raise ConfigError unless the server of the page is installed."""
    if importlib.util.find_spec("viser") is None:
        raise ConfigError(missing("viser"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `scripts/play`; returns the exit code."""
    options = parse(arguments)
    try:
        require_viser()
        play = _play_graph if options.graph else _play_robot
        with on_interrupt(signal.default_int_handler):
            play(options)
    except ConfigError as error:
        refuse(PROGRAM, error)
        return 2
    except OSError as error:
        refuse(
            PROGRAM, f"{options.host}:{options.port}: {error.strerror or error}"
        )
        return 2
    except KeyboardInterrupt:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
