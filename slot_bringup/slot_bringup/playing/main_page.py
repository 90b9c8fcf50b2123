"""Plays with the simulated robot in the browser: drive it, change it and its world, push it.

The robot, its controller and the page run in this process. The page is for this machine; with
--host ADDRESS also for others, which need the address with the token that is printed.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import io
import logging
import secrets
import signal
import socket
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from slot_bringup import interrupts
from slot_bringup.playing.access import Access, guarded, is_this_machine
from slot_core.command_line import CommandParser, command_parser, refuse, within
from slot_core.config import ConfigError
from slot_core.control.policy import DEFAULT_POLICY
from slot_lab.play.played_robot import PlayedRobot

if TYPE_CHECKING:
    import viser

PROGRAM = "scripts/play"
PORT = 8080
BAGS = Path("bags")


def parser() -> CommandParser:
    """The command line."""
    made = command_parser("play", __doc__)
    add = made.add_argument
    add("--scene", default="flat", metavar="NAME", help="of config/scene (default: flat)")
    add("--policy", default=DEFAULT_POLICY, metavar="NAME", help="policy (default: %(default)s)")
    add("--host", default="127.0.0.1", metavar="ADDRESS", help="to listen on (default: 127.0.0.1)")
    add("--port", default=PORT, type=within(0, 65535), metavar="N", help="default: %(default)s")
    return made


def address(host: str, port: int, token: str) -> str:
    """The page's address in the browser; that of a host which stands for all has its name."""
    if host in {"", "0.0.0.0", "::"}:
        host = socket.gethostname()
    return f"http://{host}:{port}/" + (f"?token={token}" if token else "")


def start_server(host: str, port: int, token: str) -> viser.ViserServer:
    """Server of the page; raises OSError if the port is taken."""
    import viser  # noqa: PLC0415 - optional

    class Server(viser.ViserServer):
        """viser's server, which nobody can connect to one elsewhere."""

        def request_share_url(self, verbose: bool = True) -> str | None:
            return None

    with socket.create_server((host, port), reuse_port=False):
        pass  # viser would take the next port
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)  # of broken connections
    with guarded(Access(token)), contextlib.redirect_stdout(io.StringIO()):
        server = Server(host=host, port=port, label="SLOT", verbose=False)
    server.gui.configure_theme(show_share_button=False, show_logo=False, control_width="large")
    return server


def play(options: argparse.Namespace) -> None:
    """Play until an interrupt; raises ConfigError and OSError."""
    robot = PlayedRobot(options.scene, options.policy)
    token = "" if is_this_machine(options.host) else secrets.token_urlsafe(24)
    server = start_server(options.host, options.port, token)
    from slot_bringup.playing.play_page import PlayPage  # noqa: PLC0415 - needs viser

    try:
        page = PlayPage(server, robot, BAGS)
        print(f"{address(options.host, server.get_port(), token)}\nCtrl-C ends it", flush=True)
        page.run(lambda: False)
    finally:
        server.stop()


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `scripts/play`; returns the exit code."""
    options = parser().parse_args(arguments)
    if importlib.util.find_spec("viser") is None:
        refuse(PROGRAM, "viser is missing; run scripts/setup --play")
        return 2
    try:
        with interrupts.on_interrupt(signal.default_int_handler):
            play(options)
    except ConfigError as error:
        refuse(PROGRAM, error)
        return 2
    except OSError as error:
        refuse(PROGRAM, f"{options.host}:{options.port}: {error.strerror or error}")
        return 2
    except KeyboardInterrupt:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
