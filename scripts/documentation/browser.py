"""Headless Chromium, driven over its DevTools protocol."""

import itertools
import json
import shutil
import subprocess
import threading
import time
import urllib.request
from contextlib import contextmanager
from pathlib import Path

from websockets.sync.client import connect

from slot_bringup.playing.page_server import address, start_server
from slot_bringup.playing.play_page import PlayPage
from slot_lab.play.played_robot import PlayedRobot

NAMES = "chromium", "google-chrome", "chromium-browser"
PROGRAM = next(filter(None, map(shutil.which, NAMES)), "")
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--remote-debugging-port=0",
    "--window-size=1200,700",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-proxy-server",
)
DEADLINE = 60.0  # s
COARSE = "?fixedDpr=0.25"  # fewer pixels of the robot, which take most of the time without a GPU


class Browser:
    """A page in Chromium; a context manager."""

    def __init__(self, directory: Path, address: str):
        command = [
            PROGRAM,
            *OPTIONS,
            f"--user-data-dir={directory}",
            address,
        ]
        self._process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        file = directory / "DevToolsActivePort"
        port = wait_for(
            lambda: file.exists() and file.read_text().split("\n")[0]
        )
        page = wait_for(lambda: _page(f"http://127.0.0.1:{port}/json"))
        self._socket = connect(
            page["webSocketDebuggerUrl"], max_size=None, proxy=None
        )
        self._number = itertools.count(1)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._socket.close()
        self._process.terminate()
        self._process.wait()

    def call(self, method, **parameters):
        """Result of a command of the protocol."""
        number = next(self._number)
        self._socket.send(
            json.dumps({"id": number, "method": method, "params": parameters})
        )
        while True:
            answer = json.loads(self._socket.recv(DEADLINE))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def run(self, script):
        """Value of an expression of JavaScript."""
        found = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def text(self):
        """Text that the page shows."""
        return self.run("document.body ? document.body.innerText : ''")

    def click(self, script):
        """Click in the middle of the element of an expression."""
        x, y = wait_for(lambda: self.run(f"({MIDDLE})({script})"))
        for kind in ("mousePressed", "mouseReleased"):
            self.mouse(kind, x, y)

    def mouse(self, kind, x, y, held=True):
        """An event of the left button, or of the mouse with no button held."""
        button, buttons = (
            ("left", int(kind != "mouseReleased")) if held else ("none", 0)
        )
        self.call(
            "Input.dispatchMouseEvent",
            type=kind,
            x=x,
            y=y,
            button=button,
            buttons=buttons,
            clickCount=int(held),
        )

    def drag(self, begin, end, steps=8):
        """Drag from one point to another, without letting go."""
        self.mouse("mouseMoved", *begin, held=False)
        self.mouse("mousePressed", *begin)
        for k in range(1, steps + 1):
            x, y = (a + (b - a) * k / steps for a, b in zip(begin, end))
            self.mouse("mouseMoved", x, y)

    def key(self, key):
        """Press a key, by its name in an event of the browser."""
        code = "Space" if key == " " else key
        for kind in ("rawKeyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=code)


@contextmanager
def playing(place: Path):
    """The page of scripts/play, which runs, its server and a browser that shows it."""
    ended, server = threading.Event(), start_server("127.0.0.1", 0, "")
    page = PlayPage(server, PlayedRobot(), place)
    runner = threading.Thread(target=page.run, args=(ended.is_set,))
    runner.start()
    try:
        site = address("127.0.0.1", server.get_port(), "") + COARSE
        with Browser(place, site) as browser:
            wait_for(lambda: "yaw rate" in browser.text(), browser.text)
            yield page, server, browser
    finally:
        ended.set()
        runner.join()
        server.stop()


MIDDLE = """element => {
  if (!element) return null;
  element.scrollIntoView({block: "center"});
  const r = element.getBoundingClientRect();
  return [r.x + r.width / 2, r.y + r.height / 2];
}"""


def wait_for(find, said=str):
    """The first true result; fails after the deadline, with what is `said` then."""
    end = time.monotonic() + DEADLINE
    while not (found := find()):
        assert time.monotonic() < end, said()
        time.sleep(0.05)
    return found


def _page(targets):
    with urllib.request.urlopen(targets) as answer:
        return next((t for t in json.load(answer) if t["type"] == "page"), None)
