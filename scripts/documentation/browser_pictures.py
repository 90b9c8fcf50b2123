"""Pictures of pages in Chromium: of scripts/play, its panels, and of a recorded run."""

import base64
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import browser  # of test/playing
import cv2
import numpy as np
from numpy.typing import NDArray

from slot_bringup.playing.page_server import address, start_server
from slot_bringup.playing.play_page import PlayPage
from slot_lab.play.played_robot import PlayedRobot

PAGE, PANELS, VIEW = (1200, 560), (1200, 2400), (1000, 640)  # px
MOMENT = 4.3  # s, of the run: after a push
# px, of the panel Plots with its tabs, and of the other four
FOUR_PLOTS, MORE = (835, 925)
WALKED = 11.0  # s, so that the plots are full
# Pixels of the robot; without a GPU they take the time.
FAST, SHARP = "?fixedDpr=0.25", "?fixedDpr=1"
TAB = "[...document.querySelectorAll('[role=tab]')].find(t => t.innerText == {!r})"
SHOWN = """(() => {
  let panel = document.querySelector("[role=tab]");
  while (panel.getBoundingClientRect().height < 80) panel = panel.parentElement;
  const {x, y, width, height} = panel.getBoundingClientRect();
  return {x, y, width, height, scale: 1};
})()"""
NOTICES = "document.querySelectorAll('[class*=Notification-closeButton]')"
Pixels = NDArray[np.uint8]


def write_page(path: Path) -> None:
    """Write the page as it opens, with the robot halted in its walk."""
    with walking(PAGE) as window:
        window.key("P")  # pause
        browser.wait_for(lambda: "paused" in window.text())
        window.call("Page.navigate", url=window.run("location.origin") + SHARP)
        browser.wait_for(lambda: "paused" in window.text())
        window.run(f"{NOTICES}.forEach(button => button.click())")
        browser.wait_for(lambda: not window.run(f"{NOTICES}.length"))
        cv2.imwrite(str(path), captured(window, None))


def write_panels(path: Path) -> None:
    """Write the panels beside and below each other."""
    with walking(PANELS) as window:
        shown = {
            name: panel(window, name)
            for name in ("Drive", "World", "Push", "Plots")
        }
    plots = shown["Plots"]
    above = beside(np.vstack([shown["Drive"], shown["Push"]]), shown["World"])
    cv2.imwrite(
        str(path),
        np.vstack(
            [above, beside(plots[:FOUR_PLOTS], plots[FOUR_PLOTS:][:MORE])]
        ),
    )


def write_view(page: Path, path: Path) -> None:
    """Write the page of a run at a moment."""
    with (
        tempfile.TemporaryDirectory() as place,
        browser.Browser(Path(place), f"{page.as_uri()}#t={MOMENT}") as window,
    ):
        resize(window, VIEW)
        browser.wait_for(lambda: str(MOMENT) in window.text())
        cv2.imwrite(str(path), captured(window, None))


def panel(window: Any, name: str) -> Pixels:
    """Image of a panel."""
    window.click(TAB.format(name))
    browser.wait_for(
        lambda: window.run(f"{TAB.format(name)}.ariaSelected") == "true"
    )
    return captured(window, window.run(SHOWN))


def beside(left: Pixels, right: Pixels) -> Pixels:
    """Two images beside each other, white below the shorter."""
    height = max(len(left), len(right))
    return np.hstack(
        [
            np.pad(
                i, ((0, height - len(i)), (0, 0), (0, 0)), constant_values=255
            )
            for i in (left, right)
        ]
    )


def captured(window: Any, clip: Any) -> Pixels:
    """Pixels of the window, or of a part of it."""
    part = {"clip": clip} if clip else {}
    data = window.call("Page.captureScreenshot", format="png", **part)["data"]
    coded = np.frombuffer(base64.b64decode(data), np.uint8)
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)


def resize(window: Any, size: tuple[int, int]) -> None:
    """Give a window a size, px."""
    width, height = size
    window.call(
        "Emulation.setDeviceMetricsOverride",
        width=width,
        height=height,
        deviceScaleFactor=1,
        mobile=False,
    )


@contextmanager
def walking(size: tuple[int, int]) -> Iterator[Any]:
    """A window of a size, px, with the page, whose robot has walked for a while."""
    ended, server = threading.Event(), start_server("127.0.0.1", 0, "")
    with tempfile.TemporaryDirectory() as place:
        page = PlayPage(server, PlayedRobot(), Path(place))
        runner = threading.Thread(target=page.run, args=(ended.is_set,))
        runner.start()
        try:
            site = address("127.0.0.1", server.get_port(), "")
            with browser.Browser(Path(place), site + FAST) as window:
                resize(window, size)
                browser.wait_for(lambda: "yaw rate" in window.text())
                for key in "GII":  # walk, twice faster
                    window.key(key)
                browser.wait_for(lambda: page.robot.time > WALKED)
                yield window
        finally:
            ended.set()
            runner.join()
            server.stop()
