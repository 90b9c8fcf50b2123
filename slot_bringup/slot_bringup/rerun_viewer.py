"""The viewer of rerun as a process of its own: a window, or a page for a browser.

It listens on the loopback only, which the Python functions of rerun cannot be told to. Its page
loads a font from one server, requests news from another and sends usage data to a third: here it is
handed on with a policy that lets the browser ask this machine alone.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlencode
from urllib.request import ProxyHandler, build_opener

LOOPBACK = "127.0.0.1"
PORT, WEB_PORT = 9876, 9090  # those of rerun; a free one if they are taken
START_TIMEOUT = 30.0  # s
# In CI the window sends no usage data; its look for a newer version ends at a closed port.
NOWHERE = f"http://{LOOPBACK}:9"
QUIET = {"CI": "1", "HTTPS_PROXY": NOWHERE, "https_proxy": NOWHERE, "ALL_PROXY": NOWHERE}
DIRECT = build_opener(ProxyHandler({}))  # whatever proxy the environment names
STOP_TIMEOUT = 5.0  # s, from SIGTERM to SIGKILL


class ViewerError(RuntimeError):
    """The viewer did not start; the message is one line."""


class Viewer:
    """The program `rerun` of the Python environment, in a session of its own."""

    def __init__(self, *, web: bool, log: Path, recording: Path | None = None) -> None:
        """Start it with a recording; it also takes what is sent to its `address`.

        Raises ViewerError if it does not listen after START_TIMEOUT.
        """
        port, inner_port = _free_port(PORT), _free_port(0)
        command = [str(Path(sys.executable).parent / "rerun"), "--bind", LOOPBACK]
        command += ["--port", str(port), "--hide-welcome-screen"]
        command += ["--serve-web", "--web-viewer-port", str(inner_port)] if web else []
        command += [str(recording)] if recording else []
        self.address = f"rerun+http://{LOOPBACK}:{port}/proxy"
        self.page = ""  # address for a browser
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                command,
                env=os.environ | QUIET,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # a Ctrl-C in the terminal does not close the window
            )
        try:
            self._await(inner_port if web else port, log)
            if web:
                self.page = _serve(inner_port, port)
        except BaseException:  # also an interrupt
            self.stop()
            raise

    def wait(self) -> None:
        """Return when the window is closed."""
        self._process.wait()

    @property
    def closed(self) -> bool:
        """Whether the window is closed."""
        return self._process.poll() is not None

    def stop(self) -> None:
        """End it."""
        if self.closed:
            return
        for number in (signal.SIGTERM, signal.SIGKILL):
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)  # `rerun` starts the viewer as its child
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(STOP_TIMEOUT)

    def _await(self, port: int, log: Path) -> None:
        deadline = time.monotonic() + START_TIMEOUT
        while not _listens(port):
            if self.closed:
                lines = log.read_text(errors="replace").strip().splitlines()
                raise ViewerError(f"rerun ended: {lines[-1] if lines else 'no output'}")
            if time.monotonic() > deadline:
                raise ViewerError(f"rerun does not listen after {START_TIMEOUT:g} s")
            time.sleep(0.05)


class _Page(BaseHTTPRequestHandler):
    """Hands on the viewer's page with the policy."""

    def __init__(self, port: int, policy: str, *connection: Any) -> None:
        self._port, self._policy = port, policy
        super().__init__(*connection)

    def do_GET(self) -> None:
        """Answer with what the viewer answers."""
        try:
            with DIRECT.open(f"http://{LOOPBACK}:{self._port}{self.path}") as answer:
                body, kind = answer.read(), answer.headers.get("Content-Type", "")
        except HTTPError as error:
            self.send_error(error.code)
            return
        except URLError:  # the viewer has ended
            self.send_error(HTTPStatus.BAD_GATEWAY)
            return
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Content-Security-Policy", self._policy)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: Any) -> None:
        """Log nothing."""


def _serve(inner_port: int, port: int) -> str:
    """Serve the page of the viewer at `inner_port`, which reads from `port`; return its address."""
    source = f"http://{LOOPBACK}:{port}"
    policy = (
        "default-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; "
        f"connect-src 'self' blob: data: {source}"
    )
    place = (LOOPBACK, _free_port(WEB_PORT))
    server = ThreadingHTTPServer(place, partial(_Page, inner_port, policy))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    query = urlencode({"url": f"rerun+{source}/proxy", "hide_welcome_screen": 1})
    return f"http://{LOOPBACK}:{place[1]}/?{query}"


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((LOOPBACK, port)) == 0


def _free_port(wanted: int) -> int:
    """The wanted TCP port of the loopback, or a free one if it is taken or zero."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, wanted))
        except OSError:
            probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
