"""Pages for the user's browser: one that is opened, and the live page of a graph that starts."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager

from slot_core.config import ConfigError

STOP_TIMEOUT = 10.0  # s, from SIGTERM to SIGKILL


def open_in_browser(address: str) -> None:
    """Open an address in the browser if there is a display to show it on."""
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(address)


def require_viser() -> None:
    """Raise ConfigError unless the server of the live page is installed."""
    if importlib.util.find_spec("viser") is None:
        raise ConfigError("viser is missing; run scripts/setup --play")


@contextmanager
def live_page(namespace: str, wait: float) -> Iterator[None]:
    """Serve the live page of a graph in a process of its own while the block runs.

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
    ]
    command += ["--namespace", namespace, "--wait", str(wait), "--open"]
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
